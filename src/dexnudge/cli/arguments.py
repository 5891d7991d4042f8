"""Options that several commands share, and how commands print."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import tyro

from dexnudge.errors import LARGEST_SEED, InputError, check_integer, printable
from dexnudge.jobs.processes import MOST_WORKERS

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

TABLE_WIDTH = 100  # columns when the output is a file or a pipe, so that tables do not depend on where they were made
MOST_LISTED = 20  # differences in one message: as many as fit on a screen
NOTHING_SUCCEEDED = 3  # exit code of what is done and written without a single success

NAME = re.compile(r"[A-Za-z0-9_-]+")  # of a ROS package or a model
ARGUMENT = re.compile(r"`(\w+)`")  # how messages of the library name one


def metavar(name: str) -> Any:
    """Return what the help shows for the value of an option."""
    return tyro.conf.arg(metavar=name, help_behavior_hint=_default_in_help)


def _default_in_help(default: str) -> str:
    return "" if default in ("None", "") else f"(default: {default})"


Units = Literal["m", "cm", "mm", "in"]
Meshes = Literal["visual", "collision"]
Flag = Annotated[bool, tyro.conf.arg(help_behavior_hint="")]
Count = Annotated[int, metavar("N")]
Text = Annotated[str, metavar("NAME")]
Set = Annotated[str, metavar("SET")]
Folder = Annotated[str, metavar("DIR")]
Folders = Annotated[tuple[str, ...], metavar("DIR...")]
Scenes = Annotated[tuple[str, ...], metavar("FAMILY...")]
OptionalCount = Annotated[int | None, metavar("N")]
OptionalFolder = Annotated[str | None, metavar("DIR")]
OptionalNumber = Annotated[float | None, metavar("X")]
OptionalSet = Annotated[str | None, metavar("SET")]
Uncertain = Annotated[tuple[str, ...], metavar("KEY=VALUE...")]
ResultFolder = tyro.conf.Positional[Annotated[str, metavar("DIR")]]


MOST_COUNTED = 10_000_000  # objects, attempts, films: more would take months


def check_at_least(minimum: int, **options: int | None) -> None:
    """Refuse an option below `minimum`, or above what anybody waits for.

    Raises:
        InputError: names it as an argument.
    """
    for name, value in options.items():
        if value is not None:
            most = {"workers": MOST_WORKERS, "seed": LARGEST_SEED}.get(name, MOST_COUNTED)
            check_integer(name, value, least=minimum, most=most)


def given(options: Any, *names: str) -> list[str]:
    """Return the options of these names, all unless some are named, that differ from their defaults."""
    chosen = [field for field in fields(options) if not names or field.name in names]
    return [field.name for field in chosen if getattr(options, field.name) != field.default]


def refuse_without(other: str, options: Any, *names: str) -> None:
    """Refuse options that do nothing without the option `other`, which the caller found not given.

    Raises:
        InputError: names the first of `names`, all fields of `options` unless some are named, that differs from its default.
    """
    for name in given(options, *names):
        raise InputError(f"`{name}` is given without `{other}`; expected both; add `{other}`, or leave it out")


def refuse_beside(other: str, options: Any, *names: str) -> None:
    """Refuse options that do nothing beside what the caller found given, `other` in words.

    Raises:
        InputError: names the first of `names` that differs from its default.
    """
    for name in given(options, *names):
        raise InputError(f"`{name}` does nothing with {other}; expected one of them; leave `{name}` out")


def refuse_unused_weights(options: Any, methods: Sequence[str]) -> None:
    """Refuse `weights` where no method draws from a model; InputError."""
    from dexnudge.sampling.methods import find_method

    if all(find_method(method).start != "prior" for method in methods):
        refuse_beside(f"`method` {', '.join(methods)}, which draws from no model", options, "weights")


Settings = TypeVar("Settings")


def settings(kind: type[Settings], options: object, **others: Any) -> Settings:
    """Return a configuration of the library: its fields are the options of the same names, and `others`."""
    known = {field.name for field in fields(kind)}  # type: ignore[arg-type]  # a dataclass
    return kind(**{name: value for name, value in {**vars(options), **others}.items() if name in known})


def with_flags(message: str, kind: Any) -> str:
    """Return a message of the library, which names arguments as `num_draws`, with a command's options: --num-draws."""
    flags = _flags(kind)
    return ARGUMENT.sub(lambda found: flags.get(found[1], found[0]), message)


def _flags(kind: Any) -> dict[str, str]:
    """Return how arguments that are options of a command are typed, by name; also by their plural, or with their unit."""
    flags: dict[str, str] = {}
    for field in fields(kind):
        group, off = field.default_factory, "no-" if field.default is True else ""
        own = dict.fromkeys(
            (field.name, f"{field.name}s", f"{field.name}_deg"), f"--{off}{field.name.replace('_', '-')}"
        )
        flags |= _flags(group) if is_dataclass(group) else own
    return flags


def out_folder(given: str | None, default: Path, *, overwrite: bool) -> Path:
    """Return the folder to write: the given one, else `default`, numbered where it is taken and not to be replaced."""
    from dexnudge.jobs.folders import free_folder

    if given is not None:
        return Path(given)
    return default if overwrite else free_folder(default)


@dataclass(frozen=True, kw_only=True)
class MeshOptions:
    """Size of objects from files."""

    units: Units = "m"
    """Unit of the numbers in mesh files."""
    length: OptionalNumber = None
    """Scale each object so that its longest side has this length [m]."""


@dataclass(frozen=True, kw_only=True)
class SetOptions(MeshOptions):
    """What every command that goes through a set of objects takes."""

    objects: Set
    """Folder of meshes, text file of paths, builtin:train, builtin:test, or a DexGraspNet meshdata folder (scale 0.08)."""
    out: Folder
    """Folder of the run; one that was stopped goes on when the same command is given again."""
    hand: Text = "shadow_lite"
    """Built-in hand, or a URDF or MJCF file."""
    seed: Count = 0
    """Objects and scenes get seeds derived from it."""
    workers: Count = 2
    """Processes; one core each."""


@dataclass(frozen=True, kw_only=True)
class DeviceOptions:
    """What every command that samples takes."""

    device: Annotated[str, metavar("cpu|cuda|cuda:N")] = "cpu"
    """Where hands are drawn, projected and verified."""


@dataclass(frozen=True, kw_only=True)
class EngineOptions:
    """What commands take that can also run on many machines."""

    engine: Literal["processes", "ray"] = "processes"
    """Processes of this machine, or a Ray cluster (needs dexnudge[cluster])."""
    ray_address: Annotated[str | None, metavar("HOST:PORT")] = None
    """A running Ray cluster; without it, one with --workers cores is started on this machine."""


@dataclass(frozen=True)
class Physics:
    """Quantities of the scene that are not geometry."""

    mass: OptionalNumber = None
    """Mass of the object [kg]; 0.15 unless given."""
    friction_hand: OptionalNumber = None
    """Coulomb coefficient between hand and object; 0.8 unless given."""
    friction_environment: OptionalNumber = None
    """Coulomb coefficient between object and surroundings; 0.4 unless given."""
    max_normal_force: OptionalNumber = None
    """Largest normal force of one finger link [N]; 5 unless given."""

    def given(self) -> dict[str, Any]:
        """Return those that the user gave, by the names that scenes use."""
        return {name: value for name, value in vars(self).items() if value is not None}


@dataclass(frozen=True)
class Turning:
    """What the object should do before it slides; in surroundings of your own it then slides only by --motion-length."""

    turn: Annotated[float | None, metavar("DEG")] = None
    """Turn it on what carries it by this angle, counter-clockwise from above where positive [deg]."""
    about: Annotated[tuple[float, float, float] | None, metavar("X Y Z")] = None
    """With --turn: point of the axis [m, world]; the centre of mass unless given, or a corner of the object where that is
    blocked."""
    tip: Annotated[float | None, metavar("DEG")] = None
    """Tip it by this angle over the edge of what carries it to which the motion leads [deg]."""

    def given(self) -> dict[str, Any]:
        """Return those that the user gave, by their names in `build_scene`."""
        about = None if self.about is None else list(self.about)  # as it is read from the files of a run
        values = {"turn_deg": self.turn, "tip_deg": self.tip, "about": about}
        return {name: value for name, value in values.items() if value is not None}


@dataclass(frozen=True)
class Plugins:
    """What installed packages bring; `dexnudge plugins` lists it."""

    term: tyro.conf.UseAppendAction[Annotated[tuple[str, ...], metavar("NAME=WEIGHT")]] = ()
    """Further energy term for guidance and projection; its own weight without =WEIGHT. Repeatable."""
    criterion: tyro.conf.UseAppendAction[Annotated[tuple[str, ...], metavar("NAME")]] = ()
    """Further condition that a draw must meet to be verified; the built-in ones always hold. Repeatable."""

    def weights(self) -> dict[str, float | None]:
        """Return the weight of each term, by name; None for its own.

        Raises:
            InputError: a weight that is no number, or a term that is named twice.
        """
        weights: dict[str, float | None] = {}
        for entry in self.term:
            name, _, weight = entry.partition("=")
            try:
                number = float(weight) if weight else None
            except ValueError as error:
                raise InputError(f"`term` got {entry!r}; expected NAME=WEIGHT with a number above 0") from error
            if name in weights:
                raise InputError(f"`term` names {name!r} twice; expected each name once")
            weights[name] = number
        return weights


@dataclass(frozen=True)
class Losses:
    """Weights of the losses that guide and project, where they should differ from the method's own; 0 switches one off."""

    weight_environment: OptionalNumber = None
    """Penetration of the surroundings."""
    weight_object: OptionalNumber = None
    """Penetration of the object."""
    weight_self: OptionalNumber = None
    """Penetration of the hand by itself."""
    weight_contact: OptionalNumber = None
    """Fingertips at the object's surface."""
    weight_limits: OptionalNumber = None
    """Joint limits and couplings, for guidance through the network; other rules never leave them."""
    weight_force: OptionalNumber = None
    """Balance of the forces during the desired motion [m^2 per squared object weight]."""
    weight_target: OptionalNumber = None
    """Fingertips that could only hold the object back are drawn to where they can push it; in the projection."""
    weight_sweep: OptionalNumber = None
    """Surroundings that the hand would run into while it is carried along the motion."""
    weight_base: OptionalNumber = None
    """Clearance of the forearm from the surroundings."""
    clearance_environment: OptionalNumber = None
    """Distance that guiding points keep from the surroundings [m]."""
    clearance_base: OptionalNumber = None
    """The same for the forearm [m]."""

    def given(self) -> dict[str, float]:
        """Return those that the user gave, by their names in `TermWeights`."""
        return {name.removeprefix("weight_"): value for name, value in vars(self).items() if value is not None}


def is_number(text: str) -> bool:
    """Whether a word is a number, NaN and infinity among them."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text  # Python's own way to group digits


def named_folders(argument: str, entries: Sequence[str]) -> dict[str, str]:
    """Return folders by name, from words such as my_hand=/home/me/my_hand.

    Raises:
        InputError: a word without a folder, a name that cannot be part of a folder's name, or one that occurs twice.
    """
    found: dict[str, str] = {}
    for entry in entries:
        name, _, folder = entry.partition("=")
        if not folder or not NAME.fullmatch(name):
            raise InputError(
                f"`{argument}` got {entry!r}; expected NAME=DIR with a name of letters, digits, _ and -, such as "
                "my_hand=/home/me/my_hand"
            )
        if name in found:
            raise InputError(f"`{argument}` names {name!r} twice; expected each name once")
        found[name] = folder
    return found


def stdout() -> Console:
    """Return the console for results; names that it prints, also in tables, may hold brackets and control characters."""
    from rich.console import Console
    from rich.text import Text as Styled

    class Plain(Console):
        def render_str(self, text: str, **options: Any) -> Styled:
            return super().render_str(printable(text), **options)

        def on_broken_pipe(self) -> None:  # rich would exit with 1
            raise  # noqa: PLE0704 - it is called where the error is handled

    console = Plain(highlight=False, markup=False)
    return console if console.is_terminal else Plain(highlight=False, markup=False, width=TABLE_WIDTH)


def say(*texts: str) -> None:
    """Print lines to stdout; no line is broken, so that paths can be copied."""
    for text in texts:
        stdout().print(text, soft_wrap=True)


@contextmanager
def counted(what: str, *, total: int | None = None) -> Iterator[Callable[..., None]]:
    """Show a bar while the block runs; what it is given takes how much is done and in all, and fields of rich's `update`.

    And a `line`, which is printed to stderr, in place of those of `ProgressLines`, where that is no terminal.
    """
    from dexnudge.jobs.progress import progress

    with progress() as bars:
        bar = bars.add_task(what, total=total)

        def show(done: float | None = None, total: float | None = None, *, line: str = "", **fields: Any) -> None:
            if bars.disable and line:
                print(printable(line), file=sys.stderr, flush=True)
            else:
                bars.update(bar, completed=done, total=total, **fields)

        yield show


def table(*columns: str) -> Table:
    """Return a table whose first column is text and whose others are numbers."""
    from rich.table import Table

    made = Table(header_style="bold")
    for index, column in enumerate(columns):
        made.add_column(column, justify="right" if index else "left", no_wrap=index == 0)
    return made


def listed(what: Sequence[str]) -> str:
    """Return the first lines, indented, and how many more there are."""
    more = [f"and {len(what) - MOST_LISTED} more"] if len(what) > MOST_LISTED else []
    return "\n".join(f"  {each}" for each in [*what[:MOST_LISTED], *more])
