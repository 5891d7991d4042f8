"""What each hand does between two evaluations of the projection: is it done, where should its fingers go, one step."""

from dexnudge.energies.descent_kernel import Moments, descend
from dexnudge.energies.hand_kernel import place_hand, sum_gradient
from dexnudge.energies.kernel_structs import FAR, HandModel, State
from dexnudge.geometry.warp_runtime import wp

IMPROVED = wp.constant(0.9)  # share of what was left under which it counts as less


@wp.struct
class Rules:
    """When a hand is done, see `ProjectionConfig`, and how long its steps are."""

    contact_gap: float
    contact_tolerance: float
    depth_tolerance: float
    force_tolerance: float
    idle_steps: int
    guided_steps: int
    patience: int
    endurance: int
    max_steps: int
    final_scale: float


@wp.struct
class Pushable:
    """`PushableSurface` as a kernel reads it; no places where another rule says where fingertips go."""

    linear: wp.array(dtype=wp.vec3)  # of each twist
    angular: wp.array(dtype=wp.vec3)
    places: wp.array(dtype=wp.vec3)  # [m]
    facing: float  # cosine of normal and velocity above which a contact cannot help
    on_top: float  # z of the normal above which it cannot; above 1 where pressing moves the object
    tip_radius: float  # [m]


@wp.struct
class Progress:
    """How far each hand is."""

    tips: wp.array(dtype=int)  # fingertip links
    square: wp.array(dtype=float)  # (B,) squared residual of the balances, 0 without one
    settled: wp.array(dtype=int)  # (B,) 0 while the user's terms still fall
    slope: wp.array2d(dtype=float)  # (B, 6 + d) gradient of the user's terms
    iterations: wp.array(dtype=int)  # (B,) steps made
    fits: wp.array(dtype=int)  # (B,) 1 where it penetrates nothing and touches
    least: wp.array(dtype=float)  # (B,) least that was left to do, over its tolerance
    since: wp.array(dtype=int)  # (B,) step of that
    converged: wp.array(dtype=int)  # (B,)


@wp.func
def cannot_help(pushable: Pushable, point: wp.vec3, normal: wp.vec3) -> bool:
    """Whether a contact faces the motion, or is on top where no press moves the object; by the object's outward normal."""
    if normal[2] > pushable.on_top:
        return True
    for k in range(pushable.linear.shape[0]):
        velocity = pushable.linear[k] + wp.cross(pushable.angular[k], point)
        if wp.dot(normal, wp.normalize(velocity)) > pushable.facing:
            return True
    return False


@wp.func
def nearest_place(pushable: Pushable, here: wp.vec3) -> wp.vec3:
    """The place nearest to a fingertip's keypoint; there is one."""
    nearest = pushable.places[0]
    for k in range(1, pushable.places.shape[0]):
        if wp.length_sq(pushable.places[k] - here) < wp.length_sq(nearest - here):
            nearest = pushable.places[k]
    return nearest


@wp.func
def misfit(rules: Rules, progress: Progress, state: State, i: int) -> float:
    """The largest depth or gap of hand i over its tolerance: at most 1 where it penetrates nothing and touches."""
    worst = float(0.0)
    nearest = float(FAR)
    for n in range(progress.tips.shape[0]):
        l = progress.tips[n]
        gap = wp.abs(state.contact_distance[i, l] - rules.contact_gap) / rules.contact_tolerance
        nearest = wp.min(nearest, gap)
        if state.contact_weight[i, l] > 0.0:
            worst = wp.max(worst, gap)
    worst = wp.max(worst, nearest)
    for l in range(state.depth.shape[1]):
        worst = wp.max(worst, wp.max(state.depth[i, l]) / rules.depth_tolerance)
    return worst


@wp.func
def path_depth(state: State, i: int) -> float:
    """How deep hand i gets on its path [m]."""
    deepest = float(0.0)
    for l in range(state.swept_depth.shape[1]):
        deepest = wp.max(deepest, state.swept_depth[i, l])
    return deepest


@wp.func
def stops(rules: Rules, progress: Progress, state: State, i: int, unbalanced: float, drawn: int) -> bool:
    """Whether hand i has converged, or gets no better; `drawn`: a fingertip is on its way to where it can push."""
    step = progress.iterations[i]
    left = misfit(rules, progress, state, i)
    fits = int(left <= 1.0)
    if fits > 0:
        left = wp.max(unbalanced, path_depth(state, i) / rules.depth_tolerance)
    falls = left < IMPROVED * progress.least[i] or fits != progress.fits[i]
    if falls or progress.settled[i] == 0 or fits * drawn > 0 or step == rules.guided_steps:
        progress.least[i] = left
        progress.since[i] = step
    progress.fits[i] = fits
    waited = step - progress.since[i]
    if fits == 0:
        return waited >= rules.endurance
    if (left <= 1.0 and progress.settled[i] > 0) or waited >= rules.patience or step >= rules.idle_steps:
        progress.converged[i] = 1
        return True
    return False


@wp.kernel(enable_backward=False)
def advance(
    hand: HandModel,
    state: State,
    moments: Moments,
    rules: Rules,
    pushable: Pushable,
    progress: Progress,
    rows: wp.array(dtype=int),
):
    """One hand: stops where it is done; else draws idle fingertips to where they can push, steps, and places its links."""
    i = rows[wp.tid()]
    if state.active[i] == 0:
        return
    step = progress.iterations[i]
    unbalanced = wp.sqrt(progress.square[i]) / rules.force_tolerance
    drawn = int(0)  # noqa: RUF046 - declares a variable of Warp
    if pushable.places.shape[0] > 0:
        asked = step < rules.idle_steps and unbalanced > 1.0
        for n in range(progress.tips.shape[0]):
            l = progress.tips[n]
            point = state.contact_point[i, l]
            normal = state.contact_normal[i, l]
            state.target_weight[i, l] = 0.0
            if asked and state.contact_weight[i, l] > 0.0 and cannot_help(pushable, point, normal):
                drawn = 1
                state.target_weight[i, l] = 1.0
                state.target[i, l] = nearest_place(pushable, point + pushable.tip_radius * normal)
    if stops(rules, progress, state, i, unbalanced, drawn):
        state.active[i] = 0
        return
    sum_gradient(hand, state, i)
    for c in range(progress.slope.shape[1]):
        state.gradient[i, c] = state.gradient[i, c] + progress.slope[i, c]
    scale = wp.pow(rules.final_scale, float(step) / float(rules.max_steps))
    descend(moments, state.root_translation, state.root_rotation, state.joint_angles, state.gradient, i, scale)
    progress.iterations[i] = step + 1
    place_hand(hand, state, i)
