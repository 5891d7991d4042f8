"""Penetration and contact of one link: its points in object, environment and other links, and their points in it."""

from dexnudge.energies.grid_kernel import (
    corner_distance,
    grid_distance,
    inside_box,
    least_distance,
    least_distance_anywhere,
)
from dexnudge.energies.kernel_structs import (
    ENVIRONMENT_NEAR_GRID,
    FAR,
    NEAR_TO_FAR,
    OBJECT_GRID,
    SWEPT_NEAR_GRID,
    TERM_BASE,
    TERM_CONTACT,
    TERM_SWEEP,
    Clusters,
    EnergyWeights,
    HandModel,
    SceneFields,
    State,
    add_wrench,
)
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
    """Lower bound [m] of the distances to the environment in a sphere.

    Of occluded space, whose depth begins with a jump, it knows only what the sphere's centre sees: guidance needs no more.
    """
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

    Also rates the same points carried along the motion, and the base's clearance.
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
        centre = translation + rotation * hand.clusters.centre[c]
        if least_environment_distance(scene, centre, hand.clusters.radius[c], lowest) < widest:
            for k in range(hand.clusters.first[c], hand.clusters.first[c + 1]):
                p = translation + rotation * hand.points[k]
                hit = environment_distance(scene, p, lowest)
                if hit[0] < widest:
                    gradient = wp.vec3()
                    here = float(weights.environment)  # the weight of the plain distance
                    if lowest == SWEPT_NEAR_GRID:
                        hinge = weights.clearance_environment - hit[0]
                        if hinge > 0.0:
                            # What the path adds to where the hand stands: nothing where it is free.
                            here = wp.max(here - weights.sweep, 0.0)
                            energy_sweep += weights.sweep * hinge * hinge
                            deepest_swept = wp.max(deepest_swept, weights.kept_clear - hit[0])
                            gradient -= 2.0 * weights.sweep * hinge * wp.vec3(hit[1], hit[2], hit[3])
                        hit = environment_distance(scene, p, ENVIRONMENT_NEAR_GRID)
                    hinge = weights.clearance_environment - hit[0]
                    if hinge > 0.0:
                        energy += weights.environment * hinge * hinge
                        energy_sweep += (here - weights.environment) * hinge * hinge
                        deepest = wp.max(deepest, weights.kept_clear - hit[0])
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


@wp.func
def fixed_points_in_link(
    hand: HandModel,
    state: State,
    fixed: wp.array(dtype=wp.vec3),
    clusters: Clusters,
    weight: float,
    clearance: float,
    kept_clear: float,
    i: int,
    l: int,
) -> wp.vec2:
    """(energy, deepest [m]) of points fixed in the working frame that are inside link l or closer than `clearance`.

    Depth counts from `kept_clear` [m] around them.
    """
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
                            deepest = wp.max(deepest, kept_clear - hit[0])
                            # The link moves, the point does not: the sign is the opposite of the point's own gradient.
                            gradient = 2.0 * weight * hinge * (rotation * wp.vec3(hit[1], hit[2], hit[3]))
                            add_wrench(state, i, l, gradient, p)
    return wp.vec2(energy, deepest)
