"""DexGraspNet's energy of a batch of hands, in Warp: what stands between the kinematics and the reduction of `hand_kernel`.

All kernels gather gradients as wrenches on links, exactly as `hand_kernel` does; its columns of energies are reused.
Working frame, [m], distances negative inside.
"""

# Warp's own language: its annotations are no Python types.
# mypy: disable-error-code="misc, no-untyped-def, operator, valid-type"

from dexnudge.energies.grid_kernel import grid_distance, inside_box
from dexnudge.energies.hand_kernel import NUM_TERMS, OBJECT_GRID, HandModel, SceneFields, State, add_wrench
from dexnudge.geometry.warp_runtime import wp

FORCE_CLOSURE = wp.constant(0)  # column of the environment's term, which a floating object does not have
PENETRATION = wp.constant(1)
SELF_PENETRATION = wp.constant(2)
CONTACT_DISTANCE = wp.constant(3)
SMALLEST = wp.constant(1.0e-9)  # [m] keeps a direction between two coincident keypoints finite


@wp.struct
class AnnealModel:
    """The points in which the energy is taken, and the weights of its terms."""

    object_points: wp.array(dtype=wp.vec3)  # [m] tested against the links
    keypoints: wp.array(dtype=wp.vec3)  # link frame [m], grouped by link
    first_keypoint: wp.array(dtype=int)  # (L + 1,)
    candidate: wp.array(dtype=wp.vec3)  # contact candidates, link frame [m]
    candidate_link: wp.array(dtype=int)
    centre: wp.vec3  # about which torques are taken [m]
    force_closure: float
    distance: float
    penetration: float
    self_penetration: float
    keypoint_distance: float  # [m]


@wp.func
def depth_in_link(hand: HandModel, state: State, i: int, l: int, p: wp.vec3) -> wp.vec4:
    """(depth [m], its gradient in p) of p inside link l; negative outside, and outside its bounding sphere -1."""
    if hand.radius[l] < 0.0:
        return wp.vec4(-1.0, 0.0, 0.0, 0.0)
    rotation = state.link_rotation[i, l]
    local = wp.transpose(rotation) * (p - state.link_translation[i, l])
    if wp.length_sq(local - hand.centre[l]) > hand.radius[l] * hand.radius[l]:
        return wp.vec4(-1.0, 0.0, 0.0, 0.0)
    header = hand.grids.headers[l]
    if not inside_box(header, local):
        return wp.vec4(-1.0, 0.0, 0.0, 0.0)
    hit = grid_distance(header, hand.grids.values, local)
    inward = -(rotation * wp.vec3(hit[1], hit[2], hit[3]))
    return wp.vec4(-hit[0], inward[0], inward[1], inward[2])


@wp.func
def depth_in_hand(hand: HandModel, state: State, i: int, p: wp.vec3) -> float:
    """Largest depth of p over the links [m]."""
    depth = float(-1.0)
    for l in range(hand.tree.parent.shape[0]):
        depth = wp.max(depth, depth_in_link(hand, state, i, l, p)[0])
    return depth


@wp.kernel(enable_backward=False)
def penetrations(hand: HandModel, scene: SceneFields, model: AnnealModel, state: State, rows: wp.array(dtype=int)):
    """E_pen of one hand's link; clears the energies of the link."""
    b, l = wp.tid()
    i = rows[b]
    for term in range(NUM_TERMS):
        state.link_energy[i, l, term] = 0.0
    if hand.radius[l] < 0.0:
        return
    rotation = state.link_rotation[i, l]
    translation = state.link_translation[i, l]
    centre = translation + rotation * hand.centre[l]
    radius = hand.radius[l]

    energy = float(0.0)
    if grid_distance(scene.grids.headers[OBJECT_GRID], scene.grids.values, centre)[0] < radius:
        for k in range(model.object_points.shape[0]):
            p = model.object_points[k]
            if wp.length_sq(p - centre) < radius * radius:
                hit = depth_in_link(hand, state, i, l, p)
                if hit[0] > 0.0:  # noqa: SIM102 - Warp would evaluate both conditions of an `and`
                    # The depth inside the hand is the largest over its links: the point counts once, for that link.
                    if hit[0] >= depth_in_hand(hand, state, i, p):
                        energy += model.penetration * hit[0]
                        # The link moves, the point does not: the sign is the opposite of the point's own gradient.
                        add_wrench(state, i, l, -model.penetration * wp.vec3(hit[1], hit[2], hit[3]), p)
    state.link_energy[i, l, PENETRATION] = energy


@wp.kernel(enable_backward=False)
def crowding(hand: HandModel, model: AnnealModel, state: State, rows: wp.array(dtype=int)):
    """E_spen between the keypoints of one hand's link and those of its partners."""
    b, l = wp.tid()
    i = rows[b]
    rotation = state.link_rotation[i, l]
    translation = state.link_translation[i, l]
    centre = translation + rotation * hand.centre[l]
    energy = float(0.0)
    for n in range(hand.first_partner[l], hand.first_partner[l + 1]):
        other = hand.partner[n]
        far = state.link_translation[i, other] + state.link_rotation[i, other] * hand.centre[other]
        if wp.length(centre - far) < hand.radius[l] + hand.radius[other] + model.keypoint_distance:
            for k in range(model.first_keypoint[l], model.first_keypoint[l + 1]):
                p = translation + rotation * model.keypoints[k]
                for m in range(model.first_keypoint[other], model.first_keypoint[other + 1]):
                    o = state.link_translation[i, other] + state.link_rotation[i, other] * model.keypoints[m]
                    apart = wp.length(p - o)
                    if apart < model.keypoint_distance:
                        energy += model.self_penetration * (model.keypoint_distance - apart)
                        gradient = -model.self_penetration * (p - o) / wp.max(apart, SMALLEST)
                        add_wrench(state, i, l, gradient, p)
                        add_wrench(state, i, other, -gradient, o)
    state.link_energy[i, l, SELF_PENETRATION] = energy


@wp.kernel(enable_backward=False)
def contacts(
    scene: SceneFields, model: AnnealModel, state: State, chosen: wp.array2d(dtype=int), rows: wp.array(dtype=int)
):
    """E_fc and E_dis of one hand over its chosen candidates; E_fc's gradient holds the normals fixed."""
    i = rows[wp.tid()]
    header = scene.grids.headers[OBJECT_GRID]
    force = wp.vec3()
    torque = wp.vec3()
    energy = float(0.0)
    for c in range(chosen.shape[1]):
        l = model.candidate_link[chosen[i, c]]
        p = state.link_translation[i, l] + state.link_rotation[i, l] * model.candidate[chosen[i, c]]
        hit = grid_distance(header, scene.grids.values, p)
        normal = wp.normalize(wp.vec3(hit[1], hit[2], hit[3]))
        force += normal
        torque += wp.cross(p - model.centre, normal)
        energy += model.distance * wp.abs(hit[0])
    for c in range(chosen.shape[1]):
        l = model.candidate_link[chosen[i, c]]
        p = state.link_translation[i, l] + state.link_rotation[i, l] * model.candidate[chosen[i, c]]
        hit = grid_distance(header, scene.grids.values, p)
        normal = wp.normalize(wp.vec3(hit[1], hit[2], hit[3]))
        gradient = model.distance * wp.sign(hit[0]) * normal + 2.0 * model.force_closure * wp.cross(normal, torque)
        add_wrench(state, i, l, gradient, p)
    state.link_energy[i, 0, FORCE_CLOSURE] = model.force_closure * (wp.length_sq(force) + wp.length_sq(torque))
    state.link_energy[i, 0, CONTACT_DISTANCE] = energy
