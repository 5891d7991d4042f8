"""Penetration of the hand by itself: the points of one link in the grid of another."""

# Warp's own language: its annotations are no Python types.
# mypy: disable-error-code="misc, no-untyped-def, operator, valid-type"

from dexnudge.energies.grid_kernel import grid_distance, inside_box, least_distance
from dexnudge.energies.kernel_structs import EnergyWeights, HandModel, State
from dexnudge.geometry.warp_runtime import wp


@wp.func
def links_come_close(hand: HandModel, state: State, i: int, one: int, other: int, clearance: float) -> bool:
    """Whether two links can be closer than `clearance`: each one's bounding sphere against the other one's grid."""
    between = state.link_centre[i, one] - state.link_centre[i, other]
    reach = hand.radius[one] + hand.radius[other] + clearance
    if wp.length_sq(between) > reach * reach:
        return False
    local = wp.transpose(state.link_rotation[i, other]) * (state.link_centre[i, one] - state.link_translation[i, other])
    if least_distance(hand.grids.headers[other], hand.grids.values, local, hand.radius[one]) > clearance:
        return False
    local = wp.transpose(state.link_rotation[i, one]) * (state.link_centre[i, other] - state.link_translation[i, one])
    return least_distance(hand.grids.headers[one], hand.grids.values, local, hand.radius[other]) < clearance


@wp.func
def points_in_other_link(hand: HandModel, state: State, weights: EnergyWeights, i: int, l: int, other: int) -> wp.vec2:
    """(energy, deepest [m]) of the points of link l that are inside another link or closer than the clearance."""
    rotation = state.link_rotation[i, l]
    translation = state.link_translation[i, l]
    other_rotation = state.link_rotation[i, other]
    back = wp.transpose(other_rotation)
    turn = back * rotation
    shift = back * (translation - state.link_translation[i, other])
    header = hand.grids.headers[other]
    energy = float(0.0)
    deepest = float(0.0)
    force = wp.vec3()
    moment = wp.vec3()
    for c in range(hand.first_cluster[l], hand.first_cluster[l + 1]):
        middle = shift + turn * hand.clusters.centre[c]
        if least_distance(header, hand.grids.values, middle, hand.clusters.radius[c]) < weights.clearance_self:
            for k in range(hand.clusters.first[c], hand.clusters.first[c + 1]):
                local = shift + turn * hand.points[k]
                if inside_box(header, local):
                    hit = grid_distance(header, hand.grids.values, local)
                    hinge = weights.clearance_self - hit[0]
                    if hinge > 0.0:
                        energy += weights.self * hinge * hinge
                        deepest = wp.max(deepest, -hit[0])
                        gradient = -2.0 * weights.self * hinge * (other_rotation * wp.vec3(hit[1], hit[2], hit[3]))
                        force += gradient
                        moment += wp.cross(translation + rotation * hand.points[k], gradient)
    if energy > 0.0:
        wp.atomic_add(state.force, i, l, force)
        wp.atomic_add(state.moment, i, l, moment)
        wp.atomic_add(state.force, i, other, -force)
        wp.atomic_add(state.moment, i, other, -moment)
    return wp.vec2(energy, deepest)
