"""Recompute every figure of a result folder from its files alone, and compare."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError
from dexnudge.results.configurations import Configurations, load_configurations
from dexnudge.results.samples import Samples
from dexnudge.results.summary import count_draws, read_summary
from dexnudge.results.writing import as_configurations, check_joints, read_inputs
from dexnudge.verification.verdicts import verify

PENETRATION_TOLERANCE = 2e-4  # [m] what independent distance queries on the same mesh may differ by
MARGIN_TOLERANCE = 0.02  # relative; what independent solvers of the force balance may differ by


@dataclass(frozen=True)
class Check:
    """What was written and what was found again, and every difference in words (none: the folder tells the truth)."""

    written: Configurations
    found: Configurations
    differences: tuple[str, ...]

    @property
    def agrees(self) -> bool:
        """Whether everything that was written was found again."""
        return not self.differences


def check(folder: Path | str) -> Check:
    """Verify the configurations of a result folder again, with the hand and the scene of that folder.

    Raises:
        InputError: the folder or a file in it is missing, damaged, or does not belong to the others.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; expected the one that `dexnudge sample --out` wrote")
    written = load_configurations(folder)
    summary = read_summary(folder)
    scene, hand = read_inputs(folder)
    check_joints(folder, written, hand)
    scene.validate()
    again = Samples(scene, hand, written.q, verify(scene, hand, written.q.astype(np.float64)))
    found, rejected = as_configurations(again), again.rejections()
    return Check(
        written, found, (*_verdict_differences(written, found), *_summary_differences(summary, written, rejected))
    )


def _verdict_differences(written: Configurations, found: Configurations) -> list[str]:
    differences: list[str] = []
    for key in ("penetration_object", "penetration_environment", "penetration_self"):
        tolerance = np.full(len(written.q), PENETRATION_TOLERANCE)
        differences += _number_differences(key, 1e3, " mm", written, found, tolerance)
    tolerance = MARGIN_TOLERANCE * np.maximum(1.0, np.abs(found.force_margin))
    differences += _number_differences("force_margin", 1.0, "", written, found, tolerance)
    differences += [
        f"configuration {i}: success is {written.success[i]} in the file, {found.success[i]} found"
        for i in np.flatnonzero(written.success != found.success)
    ]
    differences += [
        f"configuration {i}: contact_links are {_listed(links)} in the file, {_listed(others)} found"
        for i, (links, others) in enumerate(zip(written.contact_links, found.contact_links, strict=True))
        if set(links) != set(others)
    ]
    late = np.flatnonzero(np.diff(written.success.astype(int)) > 0)
    if len(late):
        differences.append(
            f"configuration {late[0] + 1} succeeds but stands after one that does not; expected verified ones first"
        )
    return differences


def _number_differences(
    key: str,
    scale: float,
    unit: str,
    written: Configurations,
    found: Configurations,
    tolerance: Float[np.ndarray, " n"],
) -> list[str]:
    one, other = getattr(written, key), getattr(found, key)
    differing = ~(np.abs(one - other) <= tolerance) & ~(np.isnan(one) & np.isnan(other))  # NaN: never had a pose
    return [
        f"configuration {i}: {key} is {scale * one[i]:.3f}{unit} in the file, {scale * other[i]:.3f}{unit} found"
        for i in np.flatnonzero(differing)
    ]


def _listed(links: tuple[str, ...]) -> str:
    return ", ".join(links) or "none"


def _summary_differences(summary: dict[str, Any], written: Configurations, rejected: dict[str, int]) -> list[str]:
    expected = count_draws(written, rejected)
    return [
        f"summary.json: {key} is {summary.get(key)} in the file, {expected[key]} found"
        for key in ("drawn", "verified", "robust", "rejected")
        if summary.get(key) != expected[key]
    ]
