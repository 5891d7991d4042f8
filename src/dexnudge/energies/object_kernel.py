"""Penetration of the object and contact with it: a link's points in the object's grid."""

# Warp's own language: its annotations are no Python types.
# mypy: disable-error-code="misc, no-untyped-def, operator, valid-type"

from dexnudge.energies.grid_kernel import corner_distance, grid_distance, least_distance_anywhere
from dexnudge.energies.kernel_structs import (
    FAR,
    OBJECT_GRID,
    TERM_CONTACT,
    EnergyWeights,
    HandModel,
    SceneFields,
    State,
)
from dexnudge.geometry.warp_runtime import wp


@wp.func
def points_on_object(
    hand: HandModel, scene: SceneFields, weights: EnergyWeights, state: State, i: int, l: int
) -> wp.vec2:
    """(energy, deepest [m]) of the points of link l inside the object; also finds and rates the link's contact."""
    rotation = state.link_rotation[i, l]
    translation = state.link_translation[i, l]
    header = scene.grids.headers[OBJECT_GRID]
    wants_contact = state.contact_weight[i, l] > 0.0
    energy = float(0.0)
    deepest = float(0.0)
    force = wp.vec3()
    moment = wp.vec3()
    nearest = float(FAR)
    nearest_point = wp.vec3()
    nearest_normal = wp.vec3()
    first = hand.first_cluster[l]
    promising = int(first)
    lowest = float(FAR)
    for c in range(first, hand.first_cluster[l + 1]):
        centre = translation + rotation * hand.clusters.centre[c]
        at = corner_distance(header, scene.grids.values, centre)
        if at[0] + at[1] < lowest:
            lowest = at[0] + at[1]
            promising = c
    for n in range(first - 1, hand.first_cluster[l + 1]):  # the lowest one first: it rules most of the others out
        c = n
        if n < first:
            c = promising
        reach = wp.max(weights.clearance_object, nearest)
        least = float(FAR)
        if n < first or c != promising:
            centre = translation + rotation * hand.clusters.centre[c]
            least = least_distance_anywhere(header, scene.grids.values, centre, hand.clusters.radius[c])
        if least < reach:
            for k in range(hand.clusters.first[c], hand.clusters.first[c + 1]):
                p = translation + rotation * hand.points[k]
                hit = grid_distance(header, scene.grids.values, p)
                hinge = weights.clearance_object - hit[0]
                if hinge > 0.0:
                    energy += weights.object * hinge * hinge
                    deepest = wp.max(deepest, -hit[0])
                    gradient = -2.0 * weights.object * hinge * wp.vec3(hit[1], hit[2], hit[3])
                    force += gradient
                    moment += wp.cross(p, gradient)
                if hit[0] < nearest:
                    nearest = hit[0]
                    nearest_point = p
                    nearest_normal = wp.vec3(hit[1], hit[2], hit[3])
    if wants_contact:
        gap = nearest - weights.contact_gap
        scale = weights.contact * state.contact_weight[i, l]
        state.link_energy[i, l, TERM_CONTACT] = scale * gap * gap
        gradient = 2.0 * scale * gap * nearest_normal + state.extra_force[i, l]
        force += gradient
        moment += wp.cross(nearest_point, gradient)
    state.contact_distance[i, l] = nearest
    state.contact_point[i, l] = nearest_point
    state.contact_normal[i, l] = nearest_normal
    wp.atomic_add(state.force, i, l, force)
    wp.atomic_add(state.moment, i, l, moment)
    return wp.vec2(energy, deepest)
