"""Penetration of the environment: a link's points in the grids of the scene, where they are and on their way."""

# Warp's own language: its annotations are no Python types.
# mypy: disable-error-code="misc, no-untyped-def, operator, valid-type"

from dexnudge.energies.grid_kernel import grid_distance, inside_box, least_distance_anywhere
from dexnudge.energies.kernel_structs import (
    ENVIRONMENT_NEAR_GRID,
    NEAR_TO_FAR,
    SWEPT_NEAR_GRID,
    TERM_BASE,
    TERM_SWEEP,
    EnergyWeights,
    HandModel,
    SceneFields,
    State,
)
from dexnudge.geometry.warp_runtime import wp


@wp.func
def lowest_grid(scene: SceneFields, weights: EnergyWeights) -> int:
    """The near grid with the least distances that any weight asks for: the swept one, or the plain one."""
    grid = int(ENVIRONMENT_NEAR_GRID)
    if weights.sweep > 0.0 and scene.has_sweep > 0:
        grid = SWEPT_NEAR_GRID
    return grid


@wp.func
def widest_clearance(hand: HandModel, weights: EnergyWeights, l: int) -> float:
    """The distance [m] under which link l feels the environment: the base may have a clearance of its own."""
    clearance = weights.clearance_environment
    if l == hand.base and weights.base > 0.0:
        clearance = wp.max(clearance, weights.clearance_base)
    return clearance


@wp.func
def environment_distance(scene: SceneFields, p: wp.vec3, near_grid: int) -> wp.vec4:
    """(distance [m], its gradient) at p: the near grid where p lies in it, its far one elsewhere."""
    near = scene.grids.headers[near_grid]
    if inside_box(near, p):
        return grid_distance(near, scene.grids.values, p)
    return grid_distance(scene.grids.headers[near_grid + NEAR_TO_FAR], scene.grids.values, p)


@wp.func
def least_environment_distance(scene: SceneFields, centre: wp.vec3, radius: float, near_grid: int) -> float:
    """Lower bound [m] of the distances to the environment in a sphere."""
    near = scene.grids.headers[near_grid]
    if inside_box(near, centre - wp.vec3(radius, radius, radius)) and inside_box(
        near, centre + wp.vec3(radius, radius, radius)
    ):
        return least_distance_anywhere(near, scene.grids.values, centre, radius)
    # Both grids hold the same exact distances, and the coarse one errs more.
    far = scene.grids.headers[near_grid + NEAR_TO_FAR]
    return least_distance_anywhere(far, scene.grids.values, centre, radius)


@wp.func
def points_in_environment(
    hand: HandModel, scene: SceneFields, weights: EnergyWeights, state: State, i: int, l: int
) -> wp.vec2:
    """(energy, deepest [m]) of the points of link l that are inside the environment or closer than the clearance.

    Also rates the same points on their way along the motion, and the base's clearance.
    """
    rotation = state.link_rotation[i, l]
    translation = state.link_translation[i, l]
    lowest = lowest_grid(scene, weights)
    widest = widest_clearance(hand, weights, l)
    energy = float(0.0)
    energy_sweep = float(0.0)
    energy_base = float(0.0)
    deepest = float(0.0)
    deepest_swept = float(0.0)
    force = wp.vec3()
    moment = wp.vec3()
    for c in range(hand.first_cluster[l], hand.first_cluster[l + 1]):
        least = float(0.0)
        if scene.environment_jumps == 0:
            centre = translation + rotation * hand.clusters.centre[c]
            least = least_environment_distance(scene, centre, hand.clusters.radius[c], lowest)
        if least < widest:
            for k in range(hand.clusters.first[c], hand.clusters.first[c + 1]):
                p = translation + rotation * hand.points[k]
                hit = environment_distance(scene, p, lowest)
                if hit[0] < widest:
                    gradient = wp.vec3()
                    here = float(weights.environment)  # the weight of the plain distance
                    if lowest == SWEPT_NEAR_GRID:
                        hinge = weights.clearance_environment - hit[0]
                        if hinge > 0.0:
                            # What the way adds to where the hand stands: nothing where nothing is in the way.
                            here = wp.max(here - weights.sweep, 0.0)
                            energy_sweep += weights.sweep * hinge * hinge
                            deepest_swept = wp.max(deepest_swept, -hit[0])
                            gradient -= 2.0 * weights.sweep * hinge * wp.vec3(hit[1], hit[2], hit[3])
                        hit = environment_distance(scene, p, ENVIRONMENT_NEAR_GRID)
                    hinge = weights.clearance_environment - hit[0]
                    if hinge > 0.0:
                        energy += weights.environment * hinge * hinge
                        energy_sweep += (here - weights.environment) * hinge * hinge
                        deepest = wp.max(deepest, -hit[0])
                        gradient -= 2.0 * here * hinge * wp.vec3(hit[1], hit[2], hit[3])
                    if l == hand.base:
                        hinge = weights.clearance_base - hit[0]
                        if hinge > 0.0:
                            energy_base += weights.base * hinge * hinge
                            gradient -= 2.0 * weights.base * hinge * wp.vec3(hit[1], hit[2], hit[3])
                    force += gradient
                    moment += wp.cross(p, gradient)
    if energy + energy_sweep + energy_base > 0.0:
        wp.atomic_add(state.force, i, l, force)
        wp.atomic_add(state.moment, i, l, moment)
    state.link_energy[i, l, TERM_SWEEP] = energy_sweep
    state.link_energy[i, l, TERM_BASE] = energy_base
    state.swept_depth[i, l] = deepest_swept
    return wp.vec2(energy, deepest)
