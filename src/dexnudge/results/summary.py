"""summary.json: what was drawn, what became of it, and what it took."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.errors import InputError
from dexnudge.results.configurations import Configurations

FILE = "summary.json"


def count_draws(configurations: Configurations, rejected: dict[str, int]) -> dict[str, Any]:
    """Counts and rates of all draws: drawn = verified + the sum of `rejected` (reason -> draws)."""
    success, robust = configurations.success, int(configurations.robust.sum())
    drawn, verified = len(success), int(success.sum())
    return {
        "drawn": drawn,
        "verified": verified,
        "robust": robust,
        "rejected": rejected,
        "verified_rate": verified / drawn,
        "robust_rate": robust / drawn,
        "best_force_margin": float(configurations.force_margin[0]) if verified else None,
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
        raise InputError(f"{path} is missing; expected the folder that `dexnudge sample --out` wrote") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is damaged ({error}); expected JSON; sample again") from error
    if not isinstance(summary, dict) or not isinstance(summary.get("rejected"), dict):
        raise InputError(f"{path} has no counts; expected drawn, verified and rejected; sample again")
    return summary


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} does not belong in {FILE}")
