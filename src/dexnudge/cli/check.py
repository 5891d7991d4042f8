"""`dexnudge check`: is what a result folder says true?"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from dexnudge.cli.arguments import metavar
from dexnudge.errors import InputError

MOST_DIFFERENCES = 20  # in one message; the rest is counted


@dataclass(frozen=True)
class Check:
    """Recompute every figure of a result folder from its files alone and compare.

    Exit code 0: all agree. 2: something differs, or a file is missing or damaged.
    """

    folder: tyro.conf.Positional[Annotated[str, metavar("DIR")]]
    """Folder that `sample` wrote."""

    def run(self) -> int:
        """Check, print, and raise InputError with the differences, if any."""
        from dexnudge.cli.console import stdout, table
        from dexnudge.results.checking import check_folder

        check = check_folder(Path(self.folder))
        found, written = check.found, check.written
        shown = table("figure", "written", "found", "largest difference")
        shown.add_row("configurations", str(len(written.q)), str(len(found.q)), "")
        shown.add_row("verified", str(int(written.success.sum())), str(int(found.success.sum())), "")
        for key, scale, unit in (
            ("penetration_object", 1e3, "mm"),
            ("penetration_environment", 1e3, "mm"),
            ("penetration_self", 1e3, "mm"),
            ("force_margin", 1.0, ""),
        ):
            one, other = scale * getattr(written, key), scale * getattr(found, key)
            label = f"{key} {f'[{unit}], max' if unit else 'min'}"
            extreme = max if unit else min
            shown.add_row(label, f"{extreme(one):.3f}", f"{extreme(other):.3f}", f"{abs(one - other).max():.4f}")
        stdout().print(shown)
        if not check.agrees:
            listed = "\n".join(f"  {difference}" for difference in check.differences[:MOST_DIFFERENCES])
            more = len(check.differences) - MOST_DIFFERENCES
            raise InputError(
                f"{self.folder}: {len(check.differences)} figures differ from what the files give:\n{listed}"
                + (f"\n  and {more} more" if more > 0 else "")
                + "\nexpected all to agree; sample again"
            )
        stdout().print("every figure agrees")
        return 0
