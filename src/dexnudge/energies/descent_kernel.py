"""One step of Adam on one hand, as a Warp function: see `descent`."""

from dexnudge.geometry.warp_runtime import wp

FLOOR = wp.constant(1.0e-10)


@wp.struct
class Moments:
    """Moments of a batch of hands, and the moves that a hand may make."""

    first: wp.array2d(dtype=float)  # (B, 6 + d)
    second: wp.array2d(dtype=float)  # (B, 3) of translation, rotation and joint angles
    count: wp.array(dtype=int)  # (B,) steps since the moments began
    sizes: wp.array(dtype=float)  # (6 + d,) of a step
    scales: wp.array(dtype=float)  # (6 + d,) what counts as 1 of each coordinate
    lower: wp.array(dtype=float)  # (d,)
    upper: wp.array(dtype=float)  # (d,)
    coupled: wp.array2d(dtype=int)  # (pairs, 2) follower and leader
    first_decay: float  # share of a moment that is kept in a step
    second_decay: float
    tied: int  # 1 where both joints of a pair turn alike


@wp.func
def clamp_joints(moments: Moments, joint_angles: wp.array2d(dtype=float), i: int):
    """As `Hand.clamp`, and where they are tied as `Hand.equalise_tendon_joints`."""
    for k in range(moments.coupled.shape[0]):
        follower = moments.coupled[k, 0]
        leader = moments.coupled[k, 1]
        excess = 0.5 * wp.max(joint_angles[i, follower] - joint_angles[i, leader], 0.0)
        joint_angles[i, follower] = joint_angles[i, follower] - excess
        joint_angles[i, leader] = joint_angles[i, leader] + excess
    for j in range(moments.lower.shape[0]):
        joint_angles[i, j] = wp.clamp(joint_angles[i, j], moments.lower[j], moments.upper[j])
    for k in range(moments.coupled.shape[0]):
        follower = moments.coupled[k, 0]
        leader = moments.coupled[k, 1]
        joint_angles[i, follower] = wp.min(joint_angles[i, follower], joint_angles[i, leader])
    if moments.tied > 0:
        for k in range(moments.coupled.shape[0]):
            follower = moments.coupled[k, 0]
            leader = moments.coupled[k, 1]
            mean = 0.5 * (joint_angles[i, follower] + joint_angles[i, leader])
            lower = wp.max(moments.lower[follower], moments.lower[leader])
            upper = wp.min(moments.upper[follower], moments.upper[leader])
            joint_angles[i, follower] = wp.clamp(mean, lower, upper)
            joint_angles[i, leader] = joint_angles[i, follower]


@wp.func
def kind_of(c: int) -> int:
    """0 for a coordinate of the translation, 1 of the rotation vector, 2 for a joint."""
    return wp.min(c / 3, 2)


@wp.func
def descend(
    moments: Moments,
    translation: wp.array(dtype=wp.vec3),
    rotation: wp.array(dtype=wp.mat33),
    joint_angles: wp.array2d(dtype=float),
    gradient: wp.array2d(dtype=float),
    i: int,
    scale: float,
):
    """Moves hand i by one step, `scale` times as far as the sizes say."""
    count = moments.count[i] + 1
    moments.count[i] = count
    dimension = moments.sizes.shape[0]
    squares = wp.vec3()
    for c in range(dimension):
        slope = gradient[i, c] * moments.scales[c]
        moments.first[i, c] = moments.first_decay * moments.first[i, c] + (1.0 - moments.first_decay) * slope
        squares[kind_of(c)] = squares[kind_of(c)] + slope * slope
    squares = wp.cw_div(squares, wp.vec3(3.0, 3.0, wp.max(float(dimension - 6), 1.0)))
    first = scale / (1.0 - wp.pow(moments.first_decay, float(count)))
    second = 1.0 / (1.0 - wp.pow(moments.second_decay, float(count)))
    lengths = wp.vec3()
    for kind in range(3):
        mean = moments.second_decay * moments.second[i, kind] + (1.0 - moments.second_decay) * squares[kind]
        moments.second[i, kind] = mean
        lengths[kind] = first / wp.sqrt(second * mean + FLOOR)
    move = wp.vec3()
    turn = wp.vec3()
    for c in range(dimension):
        step = -moments.sizes[c] * lengths[kind_of(c)] * moments.first[i, c]
        if c < 3:
            move[c] = step
        elif c < 6:
            turn[c - 3] = step
        else:
            joint_angles[i, c - 6] = joint_angles[i, c - 6] + step
    translation[i] = translation[i] + move
    angle = wp.length(turn)
    if angle > 0.0:
        rotation[i] = wp.quat_to_matrix(wp.quat_from_axis_angle(turn / angle, angle)) * rotation[i]
    clamp_joints(moments, joint_angles, i)


@wp.kernel(enable_backward=False)
def descend_all(
    moments: Moments,
    translation: wp.array(dtype=wp.vec3),
    rotation: wp.array(dtype=wp.mat33),
    joint_angles: wp.array2d(dtype=float),
    gradient: wp.array2d(dtype=float),
    scale: wp.array(dtype=float),
):
    """One step of every hand."""
    i = wp.tid()
    descend(moments, translation, rotation, joint_angles, gradient, i, scale[i])
