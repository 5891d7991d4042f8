"""Options for the weights and clearances of the losses that guide and project."""

from dataclasses import dataclass

from dexnudge.cli.arguments import OptionalNumber


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
