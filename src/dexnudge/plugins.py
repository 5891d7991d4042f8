"""What installed packages bring: hands, arms, scene families, energy terms, criteria, and more, by their entry points.

A package names them in its pyproject.toml:

    [project.entry-points."dexnudge.criteria"]
    manipulability = "my_package:Manipulability"

Nothing is imported before it is asked for by name, or before all are listed.
"""

from __future__ import annotations

import inspect
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
"""Entry-point group of each kind."""
_MADE_ALONE = "one, or a class or function that makes one without arguments"
EXPECTED: dict[str, tuple[str, tuple[Any, ...], dict[str, Any]]] = {
    "hand": ("a function that is called with base=True or False and returns a Hand", (), {"base": True}),
    "scene": ("a function that is called with (mesh, generator) and returns a Scene", (None, None), {}),
    "energy term": (_MADE_ALONE, (), {}),
    "criterion": (_MADE_ALONE, (), {}),
    "arm": ("a function that is called without arguments and returns an Arm", (), {}),
    "guidance rule": ("a Method, or a class or function that makes a rule without arguments", (), {}),
}
"""What an entry point of each kind must name, and the arguments that it is called with."""
_MISSING = object()
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
        InputError: it fails at import (the cause is kept), or is no such thing as a package should register.
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
    what = plugin_title(kind, name)
    if EntryPoint.pattern.match(entry.value) is None:
        raise InputError(
            f"{what} is registered as '{entry.value}'; expected module:name; mend the package's entry point"
        )
    where = f"{what} cannot be imported from '{entry.value}'"
    found = call_foreign(where, entry.load, mend="; mend or uninstall the package")
    _check_kind(kind, found, f"{what}, '{entry.value}',")
    return found


def plugin_title(kind: str, name: str) -> str:
    """Return how messages call what a package registered: its kind, name and package."""
    return f"{kind} '{name}' of package {_source(_entries(kind)[name])}"


def _check_kind(kind: str, found: Any, what: str) -> None:
    """Refuse what cannot be called, or not with the arguments that a package's entry of this kind gets; InputError."""
    if kind not in EXPECTED:
        return
    expected, arguments, options = EXPECTED[kind]
    instance = not isinstance(found, type)
    named, makes = (instance and has_attribute(what, found, name) for name in ("name", "make_rule"))
    if not callable(found) and not (kind == "guidance rule" and makes):
        raise InputError(
            f"{what} is of type {type(found).__name__}; expected {expected}; mend the package's entry point"
        )
    if not callable(found) or named:
        return  # a method, or a term or criterion that is made already
    signature = call_foreign(f"{what} cannot be read", _signature, found)
    if signature is None:
        return
    try:
        signature.bind(*arguments, **options)
    except TypeError as error:
        raise InputError(
            f"{what} cannot be called so: {error}; expected {expected}; mend its parameters, or give them defaults"
        ) from error


def _signature(found: Callable[..., Any]) -> inspect.Signature | None:
    """Return how it is called; None for some compiled code: it shows when it is called."""
    try:
        return inspect.signature(found)
    except (TypeError, ValueError):
        return None


def attribute(what: str, thing: Any, name: str, default: Any = None) -> Any:
    """Return an attribute of an object that is not ours, which may be a property of any kind; InputError where it raises."""
    return call_foreign(f"{what} has no readable `{name}`", getattr, thing, name, default)


def has_attribute(what: str, thing: Any, name: str) -> bool:
    """Whether an object that is not ours has an attribute; InputError where it raises anything else."""
    return attribute(what, thing, name, _MISSING) is not _MISSING


def call_foreign(what: str, function: Callable[..., Made], *arguments: Any, mend: str = "", **options: Any) -> Made:
    """Call a function that is not ours; whatever it raises becomes an InputError that keeps it as the cause.

    sys.exit is an error, too; Ctrl-C passes through. The message begins with `what`, such as "criterion 'mine'
    failed", and ends with `mend`.
    """
    try:
        return function(*arguments, **options)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        try:
            said = str(error)
        except Exception:  # noqa: BLE001  of the foreign error's own
            said = "(its message cannot be shown)"
        raise InputError(f"{what}: {type(error).__name__}: {said}{mend}") from error


def call_plugin(kind: str, name: str, expected: type, *arguments: Any, **options: Any) -> Any:
    """Call what a package registered under a name, and return what it makes.

    Raises:
        UnknownNameError, InputError: as `load_plugin`; also where the call fails, or makes something that is not of the
            `expected` class.
    """
    function = load_plugin(kind, name)
    what = plugin_title(kind, name)
    made = call_foreign(f"{what} failed", function, *arguments, **options)
    # A protocol's `isinstance` reads the attributes that it names, which may be properties of the package's own.
    if not call_foreign(f"{what} made what cannot be read", isinstance, made, expected):
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


def find_plugins(
    kind: str, *, builtin: tuple[str, ...] = (), find: Callable[[str], object] | None = None
) -> list[Plugin]:
    """Return everything of a kind, built-in ones first, with what is wrong about it; all packages' modules are imported.

    find: gets a package's thing by its name, as its users do, and raises InputError where it is broken; `load_plugin` alone
    unless given.
    """
    found = [Plugin(kind, name, "built in") for name in builtin]
    for name, entry in sorted(_entries(kind).items()):
        broken = ""
        try:
            find(name) if find else load_plugin(kind, name)
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
