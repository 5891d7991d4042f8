"""Arguments that several subcommands share."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import tyro


def metavar(name: str) -> Any:
    """What the help text shows for the value of an option."""
    return tyro.conf.arg(metavar=name)


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
