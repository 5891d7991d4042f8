"""`dexnudge check`: is what a result folder says true?"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from dexnudge.cli.arguments import ResultFolder, listed, say, stdout, table
from dexnudge.errors import InputError


@dataclass(frozen=True)
class Check:
    """Recompute every figure of a result folder from its files alone and compare.

    Exit code 0: all agree. 2: something differs, or a file is missing or damaged.
    """

    folder: ResultFolder
    """Folder that `sample` wrote."""

    def run(self) -> int:
        """Check, print, and raise InputError with the differences, if any."""
        import numpy as np

        from dexnudge.results.checking import check

        result = check(self.folder)
        found, written = result.found, result.written
        shown = table("figure", "written", "found", "largest difference")
        shown.add_row("configurations", str(len(written)), str(len(found)), "")
        shown.add_row("verified", str(int(written.success.sum())), str(int(found.success.sum())), "")
        own, again = written.values | written.foresight, found.values | found.foresight
        for key, value in again.items():
            if np.isnan(value).all():
                continue  # such as the probability where nothing is verified
            scale, unit = (1e3, " [mm]") if key.startswith("penetration_") else (1.0, "")
            one, other = scale * own.get(key, np.full(len(value), np.nan)), scale * value
            with np.errstate(invalid="ignore"):  # two infinities: their difference is NaN
                difference = abs(one - other)
            shown.add_row(f"{key}{unit}, largest", *(f"{_largest(x):.3f}" for x in (one, other, difference)))
        stdout().print(shown)
        if not result.agrees:
            raise InputError(
                f"{self.folder}: {len(result.differences)} figures differ from what the files give:\n"
                f"{listed(result.differences)}\nexpected all to agree; sample again"
            )
        for name, reason in result.not_recomputed.items():
            say(f"not recomputed: {name}: {reason}")
        say("every figure agrees" + (" that could be recomputed" if result.not_recomputed else ""))
        return 0


def _largest(values: Iterable[float]) -> float:
    """The largest of the values that are not NaN, which marks draws that are no pose; NaN when all are."""
    return max((value for value in values if not math.isnan(value)), default=math.nan)
