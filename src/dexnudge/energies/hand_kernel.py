"""The fused kernel: kinematics, penetration of object, environment and self, contact, and the gradient, in Warp.

Three launches per evaluation, each writing into arrays that live as long as the evaluator: (1) kinematics, one thread per
hand; (2) energies, one thread per hand and link, which gathers the gradient of every point of the link as a wrench
(force and moment about the frame's origin); (3) reduction of the wrenches along the tree to the gradient in the root's
translation and rotation vector and in the joint angles, one thread per hand.

All positions are in the working frame of the scene (see `scene_fields`); [m], distances negative inside.
"""

from dexnudge.energies.grid_kernel import PackedGrids, grid_distance, inside_box
from dexnudge.geometry.warp_runtime import wp

TERM_ENVIRONMENT = wp.constant(0)
TERM_OBJECT = wp.constant(1)
TERM_SELF = wp.constant(2)
TERM_CONTACT = wp.constant(3)
TERM_TARGET = wp.constant(4)
NUM_TERMS = 5
OBJECT_GRID = wp.constant(0)
ENVIRONMENT_NEAR_GRID = wp.constant(1)
ENVIRONMENT_FAR_GRID = wp.constant(2)
FAR = wp.constant(1.0e6)


@wp.struct
class HandModel:
    """The kinematic tree and the sparse surface points of a hand; constant."""

    parent: wp.array(dtype=int)  # (L,)
    joint: wp.array(dtype=int)  # (L,) index of the joint angle, -1 where fixed
    multiplier: wp.array(dtype=float)  # (L,)
    offset: wp.array(dtype=float)  # (L,) [rad]
    axis: wp.array(dtype=wp.vec3)  # (L,)
    origin_rotation: wp.array(dtype=wp.mat33)  # (L,)
    origin_translation: wp.array(dtype=wp.vec3)  # (L,) [m]
    points: wp.array(dtype=wp.vec3)  # (P,) link frame [m]
    first_point: wp.array(dtype=int)  # (L + 1,)
    centre: wp.array(dtype=wp.vec3)  # (L,) of the bounding sphere, link frame [m]
    radius: wp.array(dtype=float)  # (L,) [m]; negative for a link without geometry
    keypoint: wp.array(dtype=wp.vec3)  # (L,) the place that targets pull, link frame [m]
    partner: wp.array(dtype=int)  # links against which a link's points are tested, grouped by link
    first_partner: wp.array(dtype=int)  # (L + 1,)
    grids: PackedGrids  # one per link


@wp.struct
class SceneFields:
    """Distance grids of object and environment, and points of both that are tested against the links."""

    grids: PackedGrids  # object, environment near, environment far
    object_points: wp.array(dtype=wp.vec3)  # [m]
    environment_points: wp.array(dtype=wp.vec3)  # [m]
    has_environment: int


@wp.struct
class EnergyWeights:
    """Weight of each term and the clearances at which the hinges begin [m]."""

    environment: float
    object: float
    self: float
    contact: float
    target: float
    clearance_environment: float
    clearance_object: float
    clearance_self: float
    contact_gap: float


@wp.struct
class State:
    """What one evaluation reads and writes."""

    active: wp.array(dtype=int)  # (B,) 0 leaves a hand's results as the last evaluation wrote them
    root_translation: wp.array(dtype=wp.vec3)  # (B,)
    root_rotation: wp.array(dtype=wp.mat33)  # (B,)
    joint_angles: wp.array2d(dtype=float)  # (B, d)
    contact_weight: wp.array2d(dtype=float)  # (B, L)
    target: wp.array2d(dtype=wp.vec3)  # (B, L)
    target_weight: wp.array2d(dtype=float)  # (B, L)
    link_rotation: wp.array2d(dtype=wp.mat33)  # (B, L)
    link_translation: wp.array2d(dtype=wp.vec3)  # (B, L)
    force: wp.array2d(dtype=wp.vec3)  # (B, L) summed gradient in the points' positions
    moment: wp.array2d(dtype=wp.vec3)  # (B, L) the same crossed with the positions
    extra_force: wp.array2d(dtype=wp.vec3)  # (B, L) gradient that another term puts on the contact point
    contact_point: wp.array2d(dtype=wp.vec3)  # (B, L) the link's point nearest to the object
    contact_distance: wp.array2d(dtype=float)  # (B, L) [m]
    contact_normal: wp.array2d(dtype=wp.vec3)  # (B, L) gradient of the object's distance there
    depth: wp.array2d(dtype=wp.vec3)  # (B, L) deepest sparse point in environment, object, another link [m]
    link_energy: wp.array3d(dtype=float)  # (B, L, NUM_TERMS)
    energy: wp.array2d(dtype=float)  # (B, NUM_TERMS)
    gradient: wp.array2d(dtype=float)  # (B, 6 + d)


@wp.kernel(enable_backward=False)
def kinematics(hand: HandModel, state: State, first: int):
    """T_world_link of every link of one hand; clears the wrenches."""
    i = first + wp.tid()
    if state.active[i] == 0:
        return
    for l in range(hand.parent.shape[0]):
        if hand.parent[l] < 0:
            state.link_rotation[i, l] = state.root_rotation[i]
            state.link_translation[i, l] = state.root_translation[i]
        else:
            parent_rotation = state.link_rotation[i, hand.parent[l]]
            rotation = parent_rotation * hand.origin_rotation[l]
            if hand.joint[l] >= 0:
                angle = hand.multiplier[l] * state.joint_angles[i, hand.joint[l]] + hand.offset[l]
                rotation = rotation * wp.quat_to_matrix(wp.quat_from_axis_angle(hand.axis[l], angle))
            state.link_rotation[i, l] = rotation
            state.link_translation[i, l] = (
                state.link_translation[i, hand.parent[l]] + parent_rotation * hand.origin_translation[l]
            )
        state.force[i, l] = wp.vec3()
        state.moment[i, l] = wp.vec3()


@wp.func
def environment_distance(scene: SceneFields, p: wp.vec3) -> wp.vec4:
    """The near grid where p lies in it, the far one elsewhere."""
    near = scene.grids.headers[ENVIRONMENT_NEAR_GRID]
    if inside_box(near, p):
        return grid_distance(near, scene.grids.values, p)
    return grid_distance(scene.grids.headers[ENVIRONMENT_FAR_GRID], scene.grids.values, p)


@wp.func
def add_wrench(state: State, i: int, l: int, gradient: wp.vec3, p: wp.vec3):
    """Adds the gradient in the position of p, a point that moves with link l."""
    wp.atomic_add(state.force, i, l, gradient)
    wp.atomic_add(state.moment, i, l, wp.cross(p, gradient))


@wp.func
def fixed_points_in_link(
    hand: HandModel, state: State, points: wp.array(dtype=wp.vec3), weight: float, clearance: float, i: int, l: int
) -> wp.vec2:
    """(energy, deepest [m]) of points fixed in the working frame that are inside link l or closer than `clearance`."""
    rotation = state.link_rotation[i, l]
    translation = state.link_translation[i, l]
    centre = translation + rotation * hand.centre[l]
    reach = hand.radius[l] + clearance
    header = hand.grids.headers[l]
    energy = float(0.0)
    deepest = float(0.0)
    for k in range(points.shape[0]):
        p = points[k]
        if wp.length_sq(p - centre) < reach * reach:
            local = wp.transpose(rotation) * (p - translation)
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


@wp.kernel(enable_backward=False)
def energies(  # noqa: C901 - the terms share one pass over the points, and that pass is where the time goes
    hand: HandModel, scene: SceneFields, weights: EnergyWeights, state: State, first: int
):
    """All terms of one hand's link, and their gradient as a wrench on the link."""
    b, l = wp.tid()
    i = first + b
    if state.active[i] == 0:
        return
    for term in range(NUM_TERMS):
        state.link_energy[i, l, term] = 0.0
    state.depth[i, l] = wp.vec3()
    state.contact_distance[i, l] = FAR
    if hand.radius[l] < 0.0:
        return

    rotation = state.link_rotation[i, l]
    translation = state.link_translation[i, l]
    centre = translation + rotation * hand.centre[l]
    radius = hand.radius[l]
    object_grid = scene.grids.headers[OBJECT_GRID]
    to_object = grid_distance(object_grid, scene.grids.values, centre)[0] - radius
    to_environment = float(FAR)
    if scene.has_environment > 0:
        to_environment = environment_distance(scene, centre)[0] - radius
    wants_contact = state.contact_weight[i, l] > 0.0
    near_object = wants_contact or to_object < weights.clearance_object
    near_environment = to_environment < weights.clearance_environment
    first_point = hand.first_point[l]
    last_point = hand.first_point[l + 1]

    energy_environment = float(0.0)
    energy_object = float(0.0)
    deepest_environment = float(0.0)
    deepest_object = float(0.0)
    if near_object or near_environment:
        force = wp.vec3()
        moment = wp.vec3()
        nearest = float(FAR)
        nearest_point = wp.vec3()
        nearest_normal = wp.vec3()
        for k in range(first_point, last_point):
            p = translation + rotation * hand.points[k]
            gradient = wp.vec3()
            if near_object:
                hit = grid_distance(object_grid, scene.grids.values, p)
                hinge = weights.clearance_object - hit[0]
                if hinge > 0.0:
                    energy_object += weights.object * hinge * hinge
                    gradient -= 2.0 * weights.object * hinge * wp.vec3(hit[1], hit[2], hit[3])
                    deepest_object = wp.max(deepest_object, -hit[0])
                if hit[0] < nearest:
                    nearest = hit[0]
                    nearest_point = p
                    nearest_normal = wp.vec3(hit[1], hit[2], hit[3])
            if near_environment:
                hit = environment_distance(scene, p)
                hinge = weights.clearance_environment - hit[0]
                if hinge > 0.0:
                    energy_environment += weights.environment * hinge * hinge
                    gradient -= 2.0 * weights.environment * hinge * wp.vec3(hit[1], hit[2], hit[3])
                    deepest_environment = wp.max(deepest_environment, -hit[0])
            force += gradient
            moment += wp.cross(p, gradient)
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

    if to_object < weights.clearance_object:
        found = fixed_points_in_link(hand, state, scene.object_points, weights.object, weights.clearance_object, i, l)
        energy_object += found[0]
        deepest_object = wp.max(deepest_object, found[1])
    if near_environment:
        found = fixed_points_in_link(
            hand, state, scene.environment_points, weights.environment, weights.clearance_environment, i, l
        )
        energy_environment += found[0]
        deepest_environment = wp.max(deepest_environment, found[1])

    energy_self = float(0.0)
    deepest_self = float(0.0)
    for n in range(hand.first_partner[l], hand.first_partner[l + 1]):
        other = hand.partner[n]
        other_rotation = state.link_rotation[i, other]
        other_translation = state.link_translation[i, other]
        header = hand.grids.headers[other]
        between = centre - (other_translation + other_rotation * hand.centre[other])
        if wp.length(between) < radius + hand.radius[other] + weights.clearance_self:
            back = wp.transpose(other_rotation)
            apart = grid_distance(header, hand.grids.values, back * (centre - other_translation))[0]
            if apart < radius + weights.clearance_self:
                for k in range(first_point, last_point):
                    p = translation + rotation * hand.points[k]
                    local = back * (p - other_translation)
                    if inside_box(header, local):
                        hit = grid_distance(header, hand.grids.values, local)
                        hinge = weights.clearance_self - hit[0]
                        if hinge > 0.0:
                            energy_self += weights.self * hinge * hinge
                            deepest_self = wp.max(deepest_self, -hit[0])
                            gradient = -2.0 * weights.self * hinge * (other_rotation * wp.vec3(hit[1], hit[2], hit[3]))
                            add_wrench(state, i, l, gradient, p)
                            add_wrench(state, i, other, -gradient, p)

    if state.target_weight[i, l] > 0.0:
        p = translation + rotation * hand.keypoint[l]
        offset = p - state.target[i, l]
        scale = weights.target * state.target_weight[i, l]
        state.link_energy[i, l, TERM_TARGET] = scale * wp.length_sq(offset)
        add_wrench(state, i, l, 2.0 * scale * offset, p)

    state.link_energy[i, l, TERM_ENVIRONMENT] = energy_environment
    state.link_energy[i, l, TERM_OBJECT] = energy_object
    state.link_energy[i, l, TERM_SELF] = energy_self
    state.depth[i, l] = wp.vec3(deepest_environment, deepest_object, deepest_self)


@wp.kernel(enable_backward=False)
def reduce_gradient(hand: HandModel, state: State, first: int):
    """Sums energies over links and carries the wrenches from the tips to the root."""
    i = first + wp.tid()
    if state.active[i] == 0:
        return
    links = hand.parent.shape[0]
    for term in range(NUM_TERMS):
        total = float(0.0)
        for l in range(links):
            total += state.link_energy[i, l, term]
        state.energy[i, term] = total
    for c in range(state.gradient.shape[1]):
        state.gradient[i, c] = 0.0
    for n in range(links):
        l = links - 1 - n
        force = state.force[i, l]
        moment = state.moment[i, l]
        if hand.parent[l] < 0:
            about_root = moment - wp.cross(state.root_translation[i], force)
            for c in range(3):
                state.gradient[i, c] = force[c]
                state.gradient[i, 3 + c] = about_root[c]
        else:
            state.force[i, hand.parent[l]] += force
            state.moment[i, hand.parent[l]] += moment
            if hand.joint[l] >= 0:
                axis = state.link_rotation[i, l] * hand.axis[l]
                torque = wp.dot(axis, moment - wp.cross(state.link_translation[i, l], force))
                state.gradient[i, 6 + hand.joint[l]] += hand.multiplier[l] * torque
