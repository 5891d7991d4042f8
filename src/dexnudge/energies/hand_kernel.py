"""The fused kernel: kinematics, penetration of object, environment and self, contact, and the gradient, in Warp.

Three launches per evaluation, each writing into arrays that live as long as the evaluator: (1) kinematics, one thread per
hand; (2) energies, one thread per hand and link, which gathers the gradient of every point of the link as a wrench
(force and moment about the frame's origin); (3) reduction of the wrenches along the tree to the gradient in the root's
translation and rotation vector and in the joint angles, one thread per hand. `contacts` finds what `energies` would find of
the contacts of some links, and nothing else.

The terms of one link stand in `penetration_kernel`.
All positions are in the working frame of the scene (see `kernel_inputs`); [m], distances negative inside.
"""

from dexnudge.energies.grid_kernel import grid_distance
from dexnudge.energies.kernel_structs import (
    FAR,
    NUM_TERMS,
    OBJECT_GRID,
    TERM_ENVIRONMENT,
    TERM_OBJECT,
    TERM_SELF,
    TERM_TARGET,
    EnergyWeights,
    HandModel,
    SceneFields,
    State,
    add_wrench,
)
from dexnudge.energies.penetration_kernel import (
    environment_distance,
    fixed_points_in_link,
    links_come_close,
    lowest_grid,
    points_in_environment,
    points_in_other_link,
    points_on_object,
    widest_clearance,
)
from dexnudge.geometry.warp_runtime import wp
from dexnudge.hands.kinematics import place_links


@wp.func
def place_hand(hand: HandModel, state: State, i: int):
    """Sets T_world_link of every link of hand i; clears the wrenches."""
    place_links(
        hand.tree,
        state.root_rotation[i],
        state.root_translation[i],
        state.joint_angles,
        i,
        state.link_rotation,
        state.link_translation,
    )
    for l in range(hand.tree.parent.shape[0]):
        state.link_centre[i, l] = state.link_translation[i, l] + state.link_rotation[i, l] * hand.centre[l]
        state.force[i, l] = wp.vec3()
        state.moment[i, l] = wp.vec3()


@wp.kernel(enable_backward=False)
def kinematics(hand: HandModel, state: State, rows: wp.array(dtype=int)):
    """Places one hand's links."""
    i = rows[wp.tid()]
    if state.active[i] > 0:
        place_hand(hand, state, i)


@wp.kernel(enable_backward=False)
def energies(hand: HandModel, scene: SceneFields, weights: EnergyWeights, state: State, rows: wp.array(dtype=int)):
    """All terms of one hand's link, and their gradient as a wrench on the link."""
    b, l = wp.tid()
    i = rows[b]
    if state.active[i] == 0:
        return
    for term in range(NUM_TERMS):
        state.link_energy[i, l, term] = 0.0
    state.depth[i, l] = wp.vec3()
    state.swept_depth[i, l] = 0.0
    state.contact_distance[i, l] = FAR
    if hand.radius[l] < 0.0:
        return

    centre = state.link_centre[i, l]
    radius = hand.radius[l]
    to_object = grid_distance(scene.grids.headers[OBJECT_GRID], scene.grids.values, centre)[0] - radius
    to_environment = float(FAR)
    if scene.has_environment > 0:
        to_environment = environment_distance(scene, centre, lowest_grid(scene, weights))[0] - radius
    near_object = to_object < weights.clearance_object
    near_environment = to_environment < widest_clearance(hand, weights, l)

    energy_environment = float(0.0)
    energy_object = float(0.0)
    deepest_environment = float(0.0)
    deepest_object = float(0.0)
    if near_object or state.contact_weight[i, l] > 0.0:
        found = points_on_object(hand, scene, weights, state, i, l)
        energy_object = found[0]
        deepest_object = found[1]
    if near_environment:
        found = points_in_environment(hand, scene, weights, state, i, l)
        energy_environment = found[0]
        deepest_environment = found[1]
    if near_object:
        found = fixed_points_in_link(
            hand, state, scene.object_points, scene.object_clusters, weights.object, weights.clearance_object, 0.0, i, l
        )
        energy_object += found[0]
        deepest_object = wp.max(deepest_object, found[1])
    if near_environment:
        found = fixed_points_in_link(
            hand,
            state,
            scene.environment_points,
            scene.environment_clusters,
            weights.environment,
            weights.clearance_environment,
            weights.kept_clear,
            i,
            l,
        )
        energy_environment += found[0]
        deepest_environment = wp.max(deepest_environment, found[1])

    energy_self = float(0.0)
    deepest_self = float(0.0)
    for n in range(hand.first_partner[l], hand.first_partner[l + 1]):
        other = hand.partner[n]
        if weights.self > 0.0 and links_come_close(hand, state, i, l, other, weights.clearance_self):
            found = points_in_other_link(hand, state, weights, i, l, other)
            energy_self += found[0]
            deepest_self = wp.max(deepest_self, found[1])

    if state.target_weight[i, l] > 0.0:
        p = state.link_translation[i, l] + state.link_rotation[i, l] * hand.keypoint[l]
        offset = p - state.target[i, l]
        scale = weights.target * state.target_weight[i, l]
        state.link_energy[i, l, TERM_TARGET] = scale * wp.length_sq(offset)
        add_wrench(state, i, l, 2.0 * scale * offset, p)

    state.link_energy[i, l, TERM_ENVIRONMENT] = energy_environment
    state.link_energy[i, l, TERM_OBJECT] = energy_object
    state.link_energy[i, l, TERM_SELF] = energy_self
    state.depth[i, l] = wp.vec3(deepest_environment, deepest_object, deepest_self)


@wp.kernel(enable_backward=False)
def contacts(
    hand: HandModel,
    scene: SceneFields,
    weights: EnergyWeights,
    state: State,
    links: wp.array(dtype=int),
    rows: wp.array(dtype=int),
):
    """The point of one hand's link that is nearest to the object."""
    b, n = wp.tid()
    i = rows[b]
    if state.active[i] == 0:
        return
    state.contact_distance[i, links[n]] = FAR
    if hand.radius[links[n]] >= 0.0:
        points_on_object(hand, scene, weights, state, i, links[n])


@wp.func
def sum_gradient(hand: HandModel, state: State, i: int):
    """Sums the energies of hand i over its links and carries the wrenches from the tips to the root."""
    links = hand.tree.parent.shape[0]
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
        if hand.tree.parent[l] < 0:
            about_root = moment - wp.cross(state.root_translation[i], force)
            for c in range(3):
                state.gradient[i, c] = force[c]
                state.gradient[i, 3 + c] = about_root[c]
        else:
            state.force[i, hand.tree.parent[l]] += force
            state.moment[i, hand.tree.parent[l]] += moment
            if hand.tree.joint[l] >= 0:
                axis = state.link_rotation[i, l] * hand.tree.axis[l]
                along = float(0.0)  # the joint: a torque about its axis, or a force where it slides along it
                if hand.tree.slides[l] > 0:
                    along = wp.dot(axis, force)
                else:
                    along = wp.dot(axis, moment - wp.cross(state.link_translation[i, l], force))
                state.gradient[i, 6 + hand.tree.joint[l]] += hand.tree.multiplier[l] * along


@wp.kernel(enable_backward=False)
def reduce_gradient(hand: HandModel, state: State, rows: wp.array(dtype=int)):
    """Energy and gradient of one hand."""
    i = rows[wp.tid()]
    if state.active[i] > 0:
        sum_gradient(hand, state, i)
