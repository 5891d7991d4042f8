"""The gradient of a link's points, gathered as a wrench: force, and moment about the origin of the working frame."""

# Warp's own language: its annotations are no Python types.
# mypy: disable-error-code="misc, no-untyped-def, operator, valid-type"

from dexnudge.energies.kernel_structs import State
from dexnudge.geometry.warp_runtime import wp


@wp.func
def add_wrench(state: State, i: int, l: int, gradient: wp.vec3, p: wp.vec3):
    """Adds the gradient in the position of p, a point that moves with link l."""
    wp.atomic_add(state.force, i, l, gradient)
    wp.atomic_add(state.moment, i, l, wp.cross(p, gradient))
