"""Options for the weights and clearances of the losses that guide and project."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.table import Table

from dexnudge.errors import InputError


def metavar(name: str) -> Any:
    """What the help text shows for the value of an option."""
    return tyro.conf.arg(metavar=name)


def check_at_least(minimum: int, **options: int) -> None:
    """Refuse an option below `minimum`; InputError that names it as it is typed."""
    for name, value in options.items():
        if value < minimum:
            raise InputError(f"--{name.replace('_', '-')} is {value}; expected {minimum} or more")


Units = Literal["m", "cm", "mm", "in"]
Count = Annotated[int, metavar("N")]
Text = Annotated[str, metavar("NAME")]
Folder = Annotated[str, metavar("DIR")]
OptionalCount = Annotated[int | None, metavar("N")]
OptionalFolder = Annotated[str | None, metavar("DIR")]
OptionalNumber = Annotated[float | None, metavar("X")]


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

    def given(self) -> dict[str, float]:
        """Those that the user gave, by the names that scenes use."""
        return {name: value for name, value in vars(self).items() if value is not None}


TABLE_WIDTH = 100  # columns when the output is a file or a pipe, so that tables do not depend on where they were made


def stdout() -> Console:
    """Console for results."""
    console = Console(highlight=False, markup=False)  # names of files and objects may hold brackets
    return console if console.is_terminal else Console(highlight=False, markup=False, width=TABLE_WIDTH)


def table(*columns: str) -> Table:
    """A table whose first column is text and whose others are numbers."""
    made = Table(header_style="bold")
    for index, column in enumerate(columns):
        made.add_column(column, justify="right" if index else "left", no_wrap=index == 0)
    return made


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
    """Joint limits and couplings, for the guidance rules that go through the network; the others never leave them."""
    weight_force: OptionalNumber = None
    """Balance of the forces during the desired motion [m^2 per squared object weight]."""
    weight_target: OptionalNumber = None
    """Pull of fingertips that push against the motion to where they can work, during the projection."""
    weight_sweep: OptionalNumber = None
    """Surroundings that the hand would run into while it is carried along the motion."""
    weight_base: OptionalNumber = None
    """Clearance of the forearm from the surroundings."""
    clearance_environment: OptionalNumber = None
    """Distance that guiding points keep from the surroundings [m]."""
    clearance_base: OptionalNumber = None
    """The same for the forearm [m]."""

    def given(self) -> dict[str, float]:
        """Those that the user gave, by their names in `TermWeights`."""
        return {name.removeprefix("weight_"): value for name, value in vars(self).items() if value is not None}
