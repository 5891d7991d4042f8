"""Penetration of the environment: a link's points in the grids of the scene."""

# Warp's own language: its annotations are no Python types.
# mypy: disable-error-code="misc, no-untyped-def, operator, valid-type"

from dexnudge.energies.grid_kernel import grid_distance, inside_box, least_distance_anywhere
from dexnudge.energies.kernel_structs import (
    ENVIRONMENT_FAR_GRID,
    ENVIRONMENT_NEAR_GRID,
    EnergyWeights,
    HandModel,
    SceneFields,
    State,
)
from dexnudge.geometry.warp_runtime import wp


@wp.func
def environment_distance(scene: SceneFields, p: wp.vec3) -> wp.vec4:
    """The near grid where p lies in it, the far one elsewhere."""
    near = scene.grids.headers[ENVIRONMENT_NEAR_GRID]
    if inside_box(near, p):
        return grid_distance(near, scene.grids.values, p)
    return grid_distance(scene.grids.headers[ENVIRONMENT_FAR_GRID], scene.grids.values, p)


@wp.func
def least_environment_distance(scene: SceneFields, centre: wp.vec3, radius: float) -> float:
    """Lower bound [m] of the distances to the environment in a sphere."""
    near = scene.grids.headers[ENVIRONMENT_NEAR_GRID]
    if inside_box(near, centre - wp.vec3(radius, radius, radius)) and inside_box(
        near, centre + wp.vec3(radius, radius, radius)
    ):
        return least_distance_anywhere(near, scene.grids.values, centre, radius)
    # Both grids hold the same exact distances, and the coarse one errs more.
    far = scene.grids.headers[ENVIRONMENT_FAR_GRID]
    return least_distance_anywhere(far, scene.grids.values, centre, radius)


@wp.func
def points_in_environment(
    hand: HandModel, scene: SceneFields, weights: EnergyWeights, state: State, i: int, l: int
) -> wp.vec2:
    """(energy, deepest [m]) of the points of link l that are inside the environment or closer than the clearance."""
    rotation = state.link_rotation[i, l]
    translation = state.link_translation[i, l]
    energy = float(0.0)
    deepest = float(0.0)
    force = wp.vec3()
    moment = wp.vec3()
    for c in range(hand.first_cluster[l], hand.first_cluster[l + 1]):
        least = float(0.0)
        if scene.environment_jumps == 0:
            centre = translation + rotation * hand.clusters.centre[c]
            least = least_environment_distance(scene, centre, hand.clusters.radius[c])
        if least < weights.clearance_environment:
            for k in range(hand.clusters.first[c], hand.clusters.first[c + 1]):
                p = translation + rotation * hand.points[k]
                hit = environment_distance(scene, p)
                hinge = weights.clearance_environment - hit[0]
                if hinge > 0.0:
                    energy += weights.environment * hinge * hinge
                    deepest = wp.max(deepest, -hit[0])
                    gradient = -2.0 * weights.environment * hinge * wp.vec3(hit[1], hit[2], hit[3])
                    force += gradient
                    moment += wp.cross(p, gradient)
    if energy > 0.0:
        wp.atomic_add(state.force, i, l, force)
        wp.atomic_add(state.moment, i, l, moment)
    return wp.vec2(energy, deepest)
