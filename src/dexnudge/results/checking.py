"""Recompute every figure of a result folder from its files alone, and compare."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.errors import InputError
from dexnudge.results.configurations import Configurations, load_configurations
from dexnudge.results.samples import Samples
from dexnudge.results.summary import count_draws, criteria_by_name, read_summary
from dexnudge.results.writing import as_configurations, check_joints, read_inputs
from dexnudge.verification.criteria import AGREEMENT, Criterion
from dexnudge.verification.verdicts import verify


@dataclass(frozen=True)
class Check:
    """What was written and what was found again.

    Attributes:
        written: the folder's configurations.
        found: the same, verified again by the criteria that are installed.
        differences: in words; none where the folder tells the truth.
        not_recomputed: criteria of the folder that could not be computed again, and why; what they found is taken as it
            stands.
    """

    written: Configurations
    found: Configurations
    differences: tuple[str, ...]
    not_recomputed: Mapping[str, str]

    @property
    def agrees(self) -> bool:
        """Whether everything that could be recomputed was found again."""
        return not self.differences


def check(folder: Path | str) -> Check:
    """Verify the configurations of a result folder again, with the hand, the scene and the criteria of that folder.

    Raises:
        InputError: the folder or a file in it is missing, damaged, or does not belong to the others.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; expected the one that `dexnudge sample` or Samples.save wrote")
    written = load_configurations(folder)
    summary = read_summary(folder)
    scene, hand = read_inputs(folder)
    check_joints(folder, written, hand)
    scene.validate()
    criteria, not_recomputed = criteria_by_name(folder, summary, written)
    verdicts = verify(scene, hand, written.q, list(criteria.values()))
    found = _with_unknown(as_configurations(Samples(scene, hand, written.q, verdicts)), written, set(not_recomputed))
    differences = (
        *_value_differences(written, found, criteria),
        *_verdict_differences(written, found),
        *_summary_differences(summary, written, found),
    )
    return Check(written, found, differences, not_recomputed)


def _with_unknown(found: Configurations, written: Configurations, unknown: set[str]) -> Configurations:
    """Return what was found, with the rejections by criteria that could not be recomputed taken as they are written."""
    reasons = [
        own if own in unknown and not (again and _earlier(again, own, written)) else again
        for again, own in zip(found.reasons, written.reasons, strict=True)
    ]
    return replace(found, reasons=tuple(reasons), success=np.array([not reason for reason in reasons], dtype=bool))


def _earlier(one: str, other: str, written: Configurations) -> bool:
    order = list(written.values)
    return order.index(one) < order.index(other)


def _value_differences(written: Configurations, found: Configurations, criteria: Mapping[str, Criterion]) -> list[str]:
    differences: list[str] = []
    for name, criterion in criteria.items():
        one, other = written.values[name], found.values[name]
        tolerance = getattr(criterion, "tolerance", AGREEMENT) * np.maximum(1.0, np.abs(other))
        differing = ~(np.abs(one - other) <= tolerance) & ~(np.isnan(one) & np.isnan(other))  # NaN: nothing to measure
        differing &= ~(one == other)  # infinities
        scale, unit = (1e3, " mm") if name.startswith("penetration_") else (1.0, "")
        differences += [
            f"configuration {i}: {name} is {scale * one[i]:.3f}{unit} in the file, {scale * other[i]:.3f}{unit} found"
            for i in np.flatnonzero(differing)
        ]
    return differences


def _verdict_differences(written: Configurations, found: Configurations) -> list[str]:
    differences = [
        f"configuration {i}: success is {written.success[i]} in the file, {found.success[i]} found"
        for i in np.flatnonzero(written.success != found.success)
    ]
    differences += [
        f"configuration {i}: the reason is {own or 'none'} in the file, {again or 'none'} found"
        for i, (own, again) in enumerate(zip(written.reasons, found.reasons, strict=True))
        if own != again
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


def _listed(links: tuple[str, ...]) -> str:
    return ", ".join(links) or "none"


def _summary_differences(summary: dict[str, Any], written: Configurations, found: Configurations) -> list[str]:
    rejected = dict(Counter(reason for reason in found.reasons if reason).most_common())
    expected = count_draws(written, rejected)
    return [
        f"summary.json: {key} is {summary.get(key)} in the file, {expected[key]} found"
        for key in ("drawn", "verified", "robust", "rejected")
        if summary.get(key) != expected[key]
    ]
