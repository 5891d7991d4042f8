"""What installed packages bring: hands, scene families, energy terms, criteria, and more, by their entry points.

A package names them in its pyproject.toml:

    [project.entry-points."dexnudge.criteria"]
    manipulability = "my_package:Manipulability"

Nothing is imported before it is asked for by name, or before all are listed.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

from dexnudge.errors import InputError, UnknownNameError, did_you_mean

GROUPS = {
    "hand": "dexnudge.hands",
    "scene": "dexnudge.scenes",
    "energy term": "dexnudge.energy_terms",
    "criterion": "dexnudge.criteria",
    "guidance rule": "dexnudge.guidance_rules",
    "arm": "dexnudge.arms",
}
"""Entry-point group of each kind; arms are reserved for a later version."""
Made = TypeVar("Made")


@dataclass(frozen=True)
class Plugin:
    """One thing that can be asked for by name.

    kind: a key of `GROUPS`. source: "built in", or the package that brings it. broken: why it cannot be used; "" if it can.
    """

    kind: str
    name: str
    source: str
    broken: str = ""


def plugin_names(kind: str) -> tuple[str, ...]:
    """Return the names that packages bring, in alphabetical order; nothing is imported."""
    return tuple(sorted(_entries(kind)))


def load_plugin(kind: str, name: str, *, known: tuple[str, ...] = ()) -> Any:
    """Return what a package registered under a name.

    Args:
        kind: a key of `GROUPS`.
        name: as in the entry point.
        known: built-in names, for the message.

    Raises:
        UnknownNameError: no package brings it; the message lists the names that exist.
        InputError: it fails at import; the cause is kept.
    """
    entries = _entries(kind)
    if name not in entries:
        names = [*known, *sorted(entries)]
        expected = f"expected one of {', '.join(names)}, or the name of one" if names else "expected the name of one"
        found = "" if names else ", of which there is none"
        raise UnknownNameError(
            f"unknown {kind} {name!r}{did_you_mean(name, names)}; {expected} that an installed package brings "
            f"(entry point '{GROUPS[kind]}'){found}"
        )
    entry = entries[name]
    what = f"{kind} '{name}' of package {_source(entry)} cannot be imported from '{entry.value}'"
    return call_foreign(what, entry.load, mend="; mend or uninstall the package")


def call_foreign(what: str, function: Callable[..., Made], *arguments: Any, mend: str = "", **options: Any) -> Made:
    """Call a function that is not ours; whatever it raises becomes an InputError that keeps it as the cause.

    The message begins with `what`, such as "criterion 'mine' failed", and ends with `mend`.
    """
    try:
        return function(*arguments, **options)
    except Exception as error:  # foreign code may raise anything, and the culprit must be named
        raise InputError(f"{what}: {type(error).__name__}: {error}{mend}") from error


def call_plugin(kind: str, name: str, expected: type, *arguments: Any, **options: Any) -> Any:
    """Call what a package registered under a name, and return what it makes.

    Raises:
        UnknownNameError, InputError: as `load_plugin`; also where the call fails, or makes something that is not of the
            `expected` class.
    """
    what = f"{kind} '{name}' of package {_source(_entries(kind)[name])}"
    made = call_foreign(f"{what} failed", load_plugin(kind, name), *arguments, **options)
    if not isinstance(made, expected):
        raise InputError(f"{what} made a {type(made).__name__}; expected a {expected.__name__}")
    return made


def usable_plugins(kind: str) -> dict[str, Any]:
    """Return everything of a kind that packages bring, by name; what is broken is named in a warning and skipped."""
    found = {}
    for name in plugin_names(kind):
        try:
            found[name] = load_plugin(kind, name)
        except InputError as error:
            warnings.warn(f"skipped: {error}", stacklevel=2)
    return found


def find_plugins(kind: str, *, builtin: tuple[str, ...] = ()) -> list[Plugin]:
    """Return everything of a kind, built-in ones first, with what is wrong about it; all packages' modules are imported."""
    found = [Plugin(kind, name, "built in") for name in builtin]
    for name, entry in sorted(_entries(kind).items()):
        broken = ""
        try:
            load_plugin(kind, name)
        except InputError as error:
            broken = str(error)
        if name in builtin:
            broken = f"the name '{name}' is taken by the built-in {kind}"
        found.append(Plugin(kind, name, _source(entry), broken))
    return found


def _entries(kind: str) -> dict[str, EntryPoint]:
    """Entry points by name; of two packages with one name the first in alphabetical order."""
    entries = sorted(entry_points(group=GROUPS[kind]), key=lambda entry: (entry.name, _source(entry)), reverse=True)
    return {entry.name: entry for entry in entries}


def _source(entry: EntryPoint) -> str:
    return "unknown" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"
