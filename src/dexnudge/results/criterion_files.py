"""Criteria in a result folder: those that need more than a name have a folder criteria/NAME of their own."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from dexnudge.errors import InputError
from dexnudge.hands.hand import Hand
from dexnudge.planning.reach import Reach
from dexnudge.plugins import call_foreign, load_plugin, plugin_title
from dexnudge.verification.criteria import Criterion, check_criteria, find_criterion

CRITERIA = "criteria"
FILES = (f"{CRITERIA}/*/*",)
"""What lies in a result folder, as patterns of paths."""
OURS: dict[str, Any] = {Reach.name: Reach}
"""Criteria of this package that need more than a name."""


def write_criteria(folder: Path, criteria: Iterable[Criterion], hand: Hand) -> None:
    """Have each criterion that has parameters save them."""
    for criterion in criteria:
        if hasattr(criterion, "save"):
            own = folder / CRITERIA / criterion.name
            own.mkdir(parents=True, exist_ok=True)
            call_foreign(f"criterion '{criterion.name}' cannot be saved", criterion.save, own, hand)


def read_criterion(folder: Path, name: str) -> Criterion:
    """Return the criterion of that name: from its own folder where it has one, else by its name alone.

    Raises:
        UnknownNameError: no such criterion.
        InputError: its files are missing or damaged.
    """
    own = folder / CRITERIA / name
    if name in OURS:
        return OURS[name].load(own)
    if not own.is_dir():
        return find_criterion(name)
    kind = load_plugin("criterion", name)
    what = plugin_title("criterion", name)
    if not hasattr(kind, "load"):
        raise InputError(f"{what} has no `load`; expected the class whose `save` wrote {own}; install that version")
    found = call_foreign(f"{what} cannot be read from {own}", kind.load, own)
    check_criteria([found])
    return found
