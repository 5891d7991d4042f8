"""summary.json: what was drawn, what became of it, and what it took."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.errors import InputError
from dexnudge.results.configurations import Configurations
from dexnudge.verification.criteria import Criterion, find_criterion

FILE = "summary.json"


def count_draws(configurations: Configurations, rejected: dict[str, int]) -> dict[str, Any]:
    """Return counts and rates of all draws: drawn = verified + the sum of `rejected` (reason -> draws)."""
    success, robust = configurations.success, int(configurations.robust.sum())
    drawn, verified = len(success), int(success.sum())
    return {
        "drawn": drawn,
        "verified": verified,
        "robust": robust,
        "rejected": rejected,
        "verified_rate": verified / drawn,
        "robust_rate": robust / drawn,
        "best_force_margin": float(configurations.values["force_margin"][0]) if verified else None,
    }


def write_summary(folder: Path, summary: dict[str, Any]) -> None:
    """Write `FILE` into `folder`."""
    text = json.dumps(summary, indent=2, allow_nan=False, default=_plain)
    (folder / FILE).write_text(text + "\n", encoding="utf-8")


def read_summary(folder: Path) -> dict[str, Any]:
    """Read `FILE` from `folder`; InputError when it is missing or damaged."""
    path = folder / FILE
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(
            f"{path} is missing; expected the folder that `dexnudge sample` or Samples.save wrote"
        ) from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is damaged ({error}); expected JSON; sample again") from error
    if not isinstance(summary, dict) or not isinstance(summary.get("rejected"), dict):
        raise InputError(f"{path} has no counts; expected drawn, verified and rejected; sample again")
    return summary


def criteria_by_name(
    folder: Path, summary: dict[str, Any], configurations: Configurations
) -> tuple[dict[str, Criterion], dict[str, str]]:
    """Return the criteria of a result folder by name, and why those that cannot be had cannot.

    Raises:
        InputError: the summary lists other criteria than configurations.npz has values of.
    """
    names = summary.get("criteria")
    if not isinstance(names, list) or {*map(str, names)} != {*configurations.values}:
        raise InputError(
            f"{folder}: summary.json lists the criteria {names}, configurations.npz has the values of "
            f"{', '.join(configurations.values)}; expected the same; sample again"
        )
    found, unavailable = {}, {}
    for name in configurations.values:
        try:
            found[name] = find_criterion(name)
        except InputError as error:
            unavailable[name] = str(error)
    return found, unavailable


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} does not belong in {FILE}")
