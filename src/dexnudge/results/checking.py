"""Recompute every figure of a result folder from its files alone, and compare."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dexnudge.geometry.devices import own_modes
from dexnudge.plugins import attribute
from dexnudge.results.folder import LONGEST_QUOTE, count_draws, read_result
from dexnudge.results.ranking import Ranking, ranking
from dexnudge.results.samples import Samples
from dexnudge.results.worlds import uncertainty_of
from dexnudge.verification.criteria import AGREEMENT
from dexnudge.verification.verdicts import Verdicts, verify


@dataclass(frozen=True, repr=False)
class Check:
    """What was written and what was found again.

    Attributes:
        written: the folder's verdicts, without contacts.
        found: those of the criteria that are installed, on the same configurations; what these are ranked by, too, where all
            could be verified again in their order.
        differences: in words; none where the folder tells the truth.
        not_recomputed: criteria of the folder that could not be computed again, and why; what they found is taken as it
            stands.
    """

    written: Verdicts
    found: Verdicts
    differences: tuple[str, ...]
    not_recomputed: Mapping[str, str]

    def __repr__(self) -> str:
        verdict = f"{len(self.differences)} figures differ" if self.differences else "every figure agrees"
        lines = [f"Check of {len(self.found)} configurations, {int(self.found.success.sum())} verified: {verdict}"]
        lines += [f"  {difference}" for difference in self.differences]
        lines += [f"  not recomputed: {name}: {reason}" for name, reason in self.not_recomputed.items()]
        return "\n".join(lines)

    @property
    def agrees(self) -> bool:
        """Whether everything that could be recomputed was found again."""
        return not self.differences


@own_modes()
def check(folder: Path | str) -> Check:
    """Verify the configurations of a result folder again, with the hand, the scene and the criteria of that folder.

    Raises:
        InputError: the folder or a file in it is missing, damaged, or does not belong to the others.
    """
    samples, summary, not_recomputed = read_result(folder)
    samples.scene.validate()
    written = samples.verdicts
    found = verify(samples.scene, samples.hand, samples.q, written.criteria)
    order = ["", *written.values]
    reasons = [  # a rejection by a criterion that is missing stands, unless an earlier one rejects too
        own if own in not_recomputed and not 0 < order.index(again) < order.index(own) else again
        for again, own in zip(found.reasons, written.reasons, strict=True)
    ]
    success = np.array([not reason for reason in reasons], dtype=bool)
    found = replace(found, reasons=reasons, success=success)
    again = _ranked(samples, written, found, measured_again=not not_recomputed)
    found = replace(found, foresight={} if again is None else again.foresight)
    differences = (
        *_value_differences(written, found),
        *_verdict_differences(written, found),
        *_rank_differences(written, again),
        *_summary_differences(summary, samples),
    )
    return Check(written, found, differences, not_recomputed)


def _value_differences(written: Verdicts, found: Verdicts) -> Iterator[str]:
    for criterion in written.criteria:
        name = criterion.name
        one, other = written.values[name], found.values[name]
        tolerance = attribute(f"criterion '{name}'", criterion, "tolerance", AGREEMENT)
        agreeing = (one == other) | (np.isnan(one) & np.isnan(other))  # NaN: nothing to measure
        finite = np.isfinite(one) & np.isfinite(other)
        agreeing[finite] = abs(one - other)[finite] <= tolerance * np.maximum(1.0, abs(other))[finite]
        scale, unit = (1e3, " mm") if name.startswith("penetration_") else (1.0, "")
        for i in np.flatnonzero(~agreeing).tolist():
            pair = scale * one[i], scale * other[i]
            digits = 3 if abs(pair[0] - pair[1]) >= 1e-3 else 6  # so that the two are told apart
            yield f"configuration {i}: {name} is {pair[0]:.{digits}f}{unit} in the file, {pair[1]:.{digits}f}{unit} found"


def _verdict_differences(written: Verdicts, found: Verdicts) -> Iterator[str]:
    for i in range(len(written)):
        if written.success[i] != found.success[i]:
            yield f"configuration {i}: success is {written.success[i]} in the file, {found.success[i]} found"
        own, again = (verdicts.reasons[i] or "none" for verdicts in (written, found))
        if own != again:
            yield f"configuration {i}: the reason is {own} in the file, {again} found"
        links, others = (verdicts.contact_links[i] for verdicts in (written, found))
        if set(links) != set(others):
            shown = ((", ".join(names) or "none")[:LONGEST_QUOTE] for names in (links, others))
            yield f"configuration {i}: contact_links are {next(shown)} in the file, {next(shown)} found"


def _ranked(samples: Samples, written: Verdicts, found: Verdicts, *, measured_again: bool) -> Ranking | None:
    """Return how what was found ranks, None where verdicts differ; an object that may lie elsewhere needs all criteria."""
    uncertainty = uncertainty_of(samples.scene)
    known = measured_again or not (uncertainty and uncertainty.displaces)
    if not known or (written.success != found.success).any() or (np.diff(written.success.astype(int)) > 0).any():
        return None
    return ranking(samples.scene, found, samples.hand, samples.q)


def _rank_differences(written: Verdicts, again: Ranking | None) -> Iterator[str]:
    """What is out of order, and what it is ranked by."""
    late = np.flatnonzero(np.diff(written.success.astype(int)) > 0) + 1
    if len(late):
        yield f"configuration {late[0]} succeeds but stands after one that does not; expected verified ones first"
    elif again is not None:
        for place in again.out_of_order().tolist():
            yield f"configuration {place} is better than the one before it; expected the best first"
        for name, value in again.foresight.items():
            if name == "probability" and name not in written.foresight:
                continue  # dexnudge 0.10 and before wrote none
            own = written.foresight.get(name, np.full(len(written), np.nan))
            for i in np.flatnonzero(
                ~np.isclose(own, value, rtol=0.0, atol=again.tolerance[name], equal_nan=True)
            ).tolist():
                yield f"configuration {i}: {name} is {own[i]:.3f} in the file, {value[i]:.3f} found"


def _summary_differences(summary: dict[str, Any], samples: Samples) -> Iterator[str]:
    """Compare with the other files: their figures are compared with what is found on their own."""
    scene = samples.scene
    known = {**count_draws(samples.verdicts), "scene": scene.name, "hand": samples.hand.name}
    if "seed" in summary and scene.seed is not None:
        known["seed"] = scene.seed
    for key, value in known.items():
        if key not in summary or summary[key] != value:
            yield f"summary.json: {key} is {str(summary.get(key))[:LONGEST_QUOTE]} in the file, {value} found"
