"""`dexnudge check`: is what a result folder says true?"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from dexnudge.cli.arguments import ResultFolder, listed, say, stdout, table
from dexnudge.errors import InputError

# Name of a figure in the file, factor to the unit shown, and that unit.
FIGURES = (
    ("penetration_object", 1e3, " [mm]"),
    ("penetration_environment", 1e3, " [mm]"),
    ("penetration_self", 1e3, " [mm]"),
    ("force_margin", 1.0, ""),
)


@dataclass(frozen=True)
class Check:
    """Recompute every figure of a result folder from its files alone and compare.

    Exit code 0: all agree. 2: something differs, or a file is missing or damaged.
    """

    folder: ResultFolder
    """Folder that `sample` wrote."""

    def run(self) -> int:
        """Check, print, and raise InputError with the differences, if any."""
        from dexnudge.results.checking import check

        result = check(self.folder)
        found, written = result.found, result.written
        shown = table("figure", "written", "found", "largest difference")
        shown.add_row("configurations", str(len(written.q)), str(len(found.q)), "")
        shown.add_row("verified", str(int(written.success.sum())), str(int(found.success.sum())), "")
        for key, scale, unit in FIGURES:
            one, other = scale * getattr(written, key), scale * getattr(found, key)
            shown.add_row(f"{key}{unit}, largest", *(f"{_largest(x):.3f}" for x in (one, other, abs(one - other))))
        stdout().print(shown)
        if not result.agrees:
            raise InputError(
                f"{self.folder}: {len(result.differences)} figures differ from what the files give:\n"
                f"{listed(result.differences)}\nexpected all to agree; sample again"
            )
        say("every figure agrees")
        return 0


def _largest(values: Iterable[float]) -> float:
    """The largest of the values that are not NaN, which marks draws that are no pose; NaN when all are."""
    return max((value for value in values if not math.isnan(value)), default=math.nan)
