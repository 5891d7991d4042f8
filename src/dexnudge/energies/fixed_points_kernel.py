"""The other way round: points of object and environment, fixed in the working frame, in the grid of a link."""

# Warp's own language: its annotations are no Python types.
# mypy: disable-error-code="misc, no-untyped-def, operator, valid-type"

from dexnudge.energies.grid_kernel import grid_distance, inside_box, least_distance
from dexnudge.energies.kernel_structs import Clusters, HandModel, State
from dexnudge.energies.wrench_kernel import add_wrench
from dexnudge.geometry.warp_runtime import wp


@wp.func
def fixed_points_in_link(
    hand: HandModel,
    state: State,
    fixed: wp.array(dtype=wp.vec3),
    clusters: Clusters,
    weight: float,
    clearance: float,
    i: int,
    l: int,
) -> wp.vec2:
    """(energy, deepest [m]) of points fixed in the working frame that are inside link l or closer than `clearance`."""
    rotation = state.link_rotation[i, l]
    translation = state.link_translation[i, l]
    back = wp.transpose(rotation)
    centre = state.link_centre[i, l]
    header = hand.grids.headers[l]
    energy = float(0.0)
    deepest = float(0.0)
    for c in range(clusters.radius.shape[0]):
        reach = hand.radius[l] + clearance + clusters.radius[c]
        if wp.length_sq(clusters.centre[c] - centre) < reach * reach:
            middle = back * (clusters.centre[c] - translation)
            if least_distance(header, hand.grids.values, middle, clusters.radius[c]) < clearance:
                for k in range(clusters.first[c], clusters.first[c + 1]):
                    p = fixed[k]
                    local = back * (p - translation)
                    if inside_box(header, local):
                        hit = grid_distance(header, hand.grids.values, local)
                        hinge = clearance - hit[0]
                        if hinge > 0.0:
                            energy += weight * hinge * hinge
                            deepest = wp.max(deepest, -hit[0])
                            # The link moves, the point does not: the sign is the opposite of the point's own gradient.
                            gradient = 2.0 * weight * hinge * (rotation * wp.vec3(hit[1], hit[2], hit[3]))
                            add_wrench(state, i, l, gradient, p)
    return wp.vec2(energy, deepest)
