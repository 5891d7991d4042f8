"""Arguments that several subcommands share."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import tyro

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
