"""Policies that push: open loop as planned, feedback that rescues a slip within its limits, one of a user's own."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError
from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.mechanics.sliding_task import GRAVITY
from dexnudge.scenes.boxes import box
from dexnudge.scenes.motion import Motion, Turn
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.feedback import Feedback
from dexnudge.simulation.feedback_limits import FeedbackLimits
from dexnudge.simulation.hand_path import PUSH, SQUEEZE, interpolated, push_path, stage_ends, twists
from dexnudge.simulation.model import TIMESTEP, SimulationModel, changed_physics, scene_model
from dexnudge.simulation.open_loop import FOLLOW_TIME, LOADED, MOST_FOLLOWED, TOUCHING, OpenLoop
from dexnudge.simulation.policy import Command, HandDrive, Observation, Policy, PushPlan, check_command
from dexnudge.simulation.push_forces import PushForces
from dexnudge.simulation.rollout import Rollout

HEIGHT, MASS, LENGTH = 0.02, 0.15, 0.05
FRICTION_HAND, FRICTION_ENVIRONMENT = 0.8, 0.4
PALM_BOTTOM = 0.11  # [m] from the palm's origin down to the lower face of its box
LIMIT = 10.0  # [N] of a link
LEAST = FRICTION_ENVIRONMENT * MASS * GRAVITY / (FRICTION_HAND - FRICTION_ENVIRONMENT)  # [N] that drags a block: 1.47
X, Y = np.eye(3)[:2]


@pytest.fixture(scope="module")
def simulation(pad_hand) -> SimulationModel:
    """The palm of the pads lies on a block that lies on a table."""
    pose = np.eye(4)
    pose[2, 3] = HEIGHT / 2
    table = box((-0.5, -0.3, -0.04), (0.5, 0.3, 0.0))
    return scene_model(pad_hand, Scene(trimesh.creation.box((0.12, 0.06, HEIGHT)), table, pose, X))


Q = np.array([0.0, 0.0, HEIGHT + PALM_BOTTOM, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
PATH = push_path(np.zeros(1), Q[None], motion=Motion(None, X, LENGTH), length=LENGTH)


def pressing(simulation: SimulationModel, normal: float, *, limit: float = LIMIT) -> PushForces:
    """The palm presses the block with this force [N], and pulls it along with what its friction then needs."""
    force = np.array([[FRICTION_ENVIRONMENT * (MASS * GRAVITY + normal), 0.0, -normal]] * 2)
    lever, unit = np.array([0.0, 0.0, -PALM_BOTTOM]), np.zeros((3, 6))
    unit[0, 2] = -1.0
    return PushForces(
        done=np.array([0.0, 1.0]),
        force=force[:, None],
        motor_torque=np.zeros((2, simulation.model.nu)),
        base_wrench=np.concatenate([force, np.cross(lever, force)], axis=1),
        cone_share=np.ones(2),
        surplus=np.ones(2),
        closing=np.zeros(simulation.model.nu),
        base_closing=np.zeros(3),
        link_force=np.array([[normal, 0.0, 0.0]] * 2),
        link_torque=np.zeros((3, simulation.model.nu)),
        link_wrench=unit,
        limit=limit,
    )


class Witness:
    """A policy that keeps what another one has seen and commanded."""

    def __init__(self, policy: Policy) -> None:
        self.policy, self.seen, self.commands = policy, [], []

    def start(self, plan):
        self.policy.start(plan)

    def command(self, seen):
        command = self.policy.command(seen)
        if command is not None:
            self.seen.append(seen)
            self.commands.append(command)
        return command


def pushed(simulation: SimulationModel, forces: PushForces, policy: Policy, **options) -> tuple[float, Witness]:
    """Way of the block [m], and what was seen and commanded."""
    rollout, witness = Rollout(simulation, Q), Witness(policy)
    rollout.push(PATH, forces, witness, **options)
    assert rollout.divergence is None
    return float(rollout.trace.object_pose[-1, 0] - rollout.trace.object_pose[0, 0]), witness


def planned_commands(simulation: SimulationModel, forces: PushForces, heights: list[float]):
    """The commands of a plan by a loop of its own, for palms that are found at these heights [m]."""
    squeezing = np.flatnonzero(PATH.phase == SQUEEZE)
    velocity, closed, loaded, followed = PATH.velocity, 0.0, 0.0, 0.0
    for step, height in enumerate(heights):
        if PATH.phase[step] == SQUEEZE:
            done = (step - squeezing[0] + 1) / len(squeezing)
            closed, loaded = np.clip([done / TOUCHING, (done - TOUCHING) / (LOADED - TOUCHING)], 0.0, 1.0)
        position = PATH.position[step] + closed * forces.base_closing
        if loaded > 0:
            followed += TIMESTEP / FOLLOW_TIME * (height - position[2] - followed)
            followed = float(np.clip(followed, -MOST_FOLLOWED, MOST_FOLLOWED))
            position[2] += followed
        torque, wrench = (
            interpolated(PATH.done[step : step + 1], forces.done, each)[0]
            for each in (forces.motor_torque, forces.base_wrench)
        )
        ctrl = PATH.angles[step] @ simulation.motor_of_angle.T + closed * forces.closing
        ctrl = ctrl + loaded * torque / simulation.motor_gain
        ctrl[simulation.base_motor] = (
            simulation.base_damping * velocity[step] / simulation.base_stiffness
            + loaded * wrench / simulation.base_stiffness
        )
        yield position, ctrl


def test_open_loop_commands_the_plan_whatever_it_sees(simulation):
    forces = replace(pressing(simulation, 4.0), base_closing=np.array([0.0, 0.0, -0.001]))
    _, witness = pushed(simulation, forces, OpenLoop(), sees=False)
    assert all(seen.T_world_object is None for seen in witness.seen)
    assert [command.phase for command in witness.commands] == PATH.phase.tolist()
    heights = [seen.T_world_palm[2, 3] for seen in witness.seen]
    for command, (position, ctrl) in zip(witness.commands, planned_commands(simulation, forces, heights), strict=True):
        np.testing.assert_allclose(command.q[:3], position, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(command.ctrl, ctrl, rtol=1e-12, atol=1e-15)


def test_what_is_sensed_is_what_is_exerted(simulation):
    _, witness = pushed(simulation, pressing(simulation, 4.0), OpenLoop())
    seen = witness.seen[-len(witness.seen) // 3]
    assert seen.link_force[0] == pytest.approx(4.0, rel=0.03)
    assert seen.base_wrench[2] == pytest.approx(-4.0, rel=0.03)
    assert seen.base_wrench[0] == pytest.approx(FRICTION_ENVIRONMENT * (MASS * GRAVITY + 4.0), rel=0.1)
    np.testing.assert_array_equal(seen.motor_torque[simulation.base_motor], 0.0)
    np.testing.assert_allclose(seen.joint_angles, 0.0, atol=1e-3)


@pytest.mark.parametrize(
    ("changed", "least"),
    [
        # N >= mu_e m g / (mu_h - mu_e) in the changed world; planned and pressed are 2 N, enough for 1.47 N.
        ({"friction_hand": 0.75}, FRICTION_ENVIRONMENT * MASS * GRAVITY / (0.6 - FRICTION_ENVIRONMENT)),
        ({"friction_environment": 1.5}, 0.6 * MASS * GRAVITY / (FRICTION_HAND - 0.6)),
        ({"mass": 2.0}, 2 * LEAST),
    ],
)
def test_feedback_presses_harder_where_the_plan_slips(simulation, changed, least):
    world, forces = changed_physics(simulation, **changed), pressing(simulation, 2.0)
    assert LEAST < 2.0 < least < FeedbackLimits().press[1] * 2.0
    stuck, _ = pushed(world, forces, OpenLoop())
    assert stuck < 0.1 * LENGTH
    moved, witness = pushed(world, forces, Feedback())
    assert moved > 0.9 * LENGTH
    pressed = np.array([seen.link_force[0] for seen in witness.seen])
    assert pressed[-100:].mean() > 0.97 * least


def test_a_press_that_rises_to_its_most_goes_over_to_the_reserve(simulation):
    loop, planned, reserve = Feedback(), pressing(simulation, 2.0), pressing(simulation, 5.0)
    loop.start(PushPlan(PATH, replace(planned, reserve=reserve), HandDrive.of(simulation)))
    step, most = len(PATH.phase) - 1, FeedbackLimits().press[1]
    hardest = FeedbackLimits().room * LIMIT
    for press, normal in ((0.5, 1.0), (1.0, 2.0), (most, hardest), ((1 + most) / 2, (1 + most) / 2 + hardest / 2)):
        loop._press = press
        links, _, wrench = loop._pressed(step)
        assert links[0] == pytest.approx(normal)
        assert wrench[2] == pytest.approx(-normal)


def test_a_hand_that_presses_too_hard_eases_off_faster_than_it_presses_harder(simulation):
    loop, start = Feedback(), pose(position=(0.0, 0.0, HEIGHT / 2))
    loop.start(PushPlan(PATH, pressing(simulation, 2.0), HandDrive.of(simulation)))
    step = int(np.flatnonzero(PATH.phase == PUSH)[0])
    for place in range(step):
        loop.command(observation(start, pose(position=PATH.position[place]), force=2.0))
    loop._press, eased = 2.0, []
    for place in range(step, step + 100):
        loop.command(
            observation(PATH.displacement[place] @ start, pose(position=PATH.position[place]), force=2 * LIMIT)
        )
        eased.append(loop._press)
    limits = FeedbackLimits()
    assert -np.diff(eased)[30] / TIMESTEP == pytest.approx(2.5 * limits.press_rate)
    assert eased[-1] == limits.press[0]


def test_where_no_press_moves_it_nothing_is_broken(simulation):
    world, forces = changed_physics(simulation, friction_hand=0.45), pressing(simulation, 4.0, limit=5.0)
    moved, witness = pushed(world, forces, Feedback())  # mu_h < mu_e: impossible
    assert abs(moved) < 0.1 * LENGTH
    limits = FeedbackLimits()
    told = np.array([command.ctrl[simulation.base_motor] for command in witness.commands]) * simulation.base_stiffness
    # Never more than a link may, plus what brings it there: the planned press is at its share of the limit already.
    assert -told[:, 2].min() <= limits.room * 5.0 + limits.base_force
    mean = np.convolve([seen.link_force[0] for seen in witness.seen], np.full(50, 0.02), mode="valid")
    assert mean.max() <= 5.0
    ahead = np.array([command.q[0] for command in witness.commands]).max() - LENGTH
    assert ahead <= limits.most_ahead[0] + limits.most_ahead[1] * LENGTH + limits.tracked[1]
    targets = np.array([command.q[:3] for command in witness.commands])
    # Giving up, the hand does not leap to the plan's end [m a step].
    assert np.abs(np.diff(targets, axis=0)).max() < 1e-3


def test_without_the_objects_pose_a_greater_pull_is_felt(simulation):
    world, forces = changed_physics(simulation, friction_environment=1.4), pressing(simulation, 3.0)
    assert pushed(world, forces, OpenLoop())[0] < 0.2 * LENGTH
    moved, witness = pushed(world, forces, Feedback(), sees=False)
    assert all(seen.T_world_object is None for seen in witness.seen)
    assert moved > 0.7 * LENGTH
    assert np.mean([seen.link_force[0] for seen in witness.seen[-100:]]) > 3.3


def test_a_policy_of_ones_own_decides(simulation):
    class Half(OpenLoop):
        """Stops half-way."""

        def command(self, seen):
            command = super().command(seen)
            return None if seen.T_world_object[0, 3] > LENGTH / 2 else command

    assert isinstance(Half(), Policy)
    moved, _ = pushed(simulation, pressing(simulation, 4.0), Half())
    assert moved == pytest.approx(LENGTH / 2, abs=1e-3)


def test_a_policy_that_never_ends_is_stopped(simulation):
    class Endless(OpenLoop):
        def command(self, seen):
            return self.at(0, seen)

    with pytest.raises(InputError) as refused:
        Rollout(simulation, Q, recorded=False).push(PATH, pressing(simulation, 4.0), Endless())
    assert str(refused.value) == (
        f"the policy Endless has given {10 * len(PATH.phase)} commands, 10 times the steps of its plan; expected None when "
        "the push is over"
    )


def test_twists_are_those_of_the_motion():
    motion = Motion(Turn(0.5, np.array([0.0, 0.0, 1.0]), np.array([0.2, 0.1, 0.0])), X, 0.03, radius=0.1)
    path = push_path(np.zeros(1), Q[None], motion=motion, length=motion.length)
    found = twists(path)
    for way in (0.02, 0.04, 0.06, 0.07):
        step = int(np.argmin(np.abs(path.done * path.length - way)))
        expected = motion.twist(way)
        np.testing.assert_allclose(found[step], np.concatenate([expected.linear, expected.angular]), atol=2e-3)


TURN_THEN_SLIDE = Motion(Turn(0.3, np.array([0.0, 0.0, 1.0]), np.zeros(3)), X, 0.03, radius=0.1)


def observation(object_pose, palm, *, force=4.0) -> Observation:
    """A robot whose palm is where it was told to be, and presses as planned."""
    return Observation(
        time=0.0,
        joint_angles=np.zeros(2),
        motor_torque=np.zeros(8),
        T_world_palm=palm,
        base_wrench=np.zeros(6),
        link_force=np.array([force, 0.0, 0.0]),
        T_world_object=object_pose,
    )


def pose(rotation=None, position=(0.0, 0.0, 0.0)):
    found = np.eye(4)
    found[:3, :3] = np.eye(3) if rotation is None else rotation.as_matrix()
    found[:3, 3] = position
    return found


def test_a_stage_ends_where_its_motion_does():
    path = push_path(np.zeros(1), Q[None], motion=TURN_THEN_SLIDE, length=TURN_THEN_SLIDE.length)
    turn, slide = stage_ends(path)
    assert path.done[turn] * path.length == pytest.approx(0.3 * 0.1, abs=1e-4)
    assert path.phase[slide] == PUSH
    assert path.phase[slide + 1] != PUSH
    assert stage_ends(PATH) == [int(np.flatnonzero(PATH.phase == PUSH)[-1])]


def test_an_object_that_turns_less_than_the_hand_has_turned_before_it_slides(simulation):
    """It turns by 80 % of the hand's turn, and slides with the hand."""
    path = push_path(np.zeros(1), Q[None], motion=TURN_THEN_SLIDE, length=TURN_THEN_SLIDE.length)
    policy, forces = Feedback(), pressing(simulation, 4.0)
    policy.start(PushPlan(path, forces, HandDrive.of(simulation)))
    palm, thing, turned_before_sliding, targets = pose(position=Q[:3]), pose(), 0.0, []
    while (command := policy.command(observation(thing, palm))) is not None:
        rotation = Rotation.from_quat(command.quaternion, scalar_first=True)
        angle = rotation.as_rotvec()[2]
        palm = pose(rotation, command.q[:3])
        thing = pose(Rotation.from_rotvec([0.0, 0.0, 0.8 * angle]), (command.q[0], command.q[1], 0.0))
        targets.append([*command.q[:2], angle])
        if command.q[0] < 1e-4:
            turned_before_sliding = 0.8 * angle
    assert turned_before_sliding > 0.3 - 2 * FeedbackLimits().close / 0.1
    assert np.hypot(*targets[-1][:2]) > 0.9 * 0.03
    assert np.abs(np.diff(targets, axis=0)).max() < 2e-3  # [m, rad a step]: no leap from one stage to the next


@pytest.mark.parametrize(("pinches", "height"), [(False, Q[2] - 0.003), (True, Q[2])])
def test_the_height_of_a_pinch_is_kept_and_that_of_a_press_follows(simulation, pinches, height):
    loop = OpenLoop()
    loop.start(PushPlan(PATH, replace(pressing(simulation, 4.0), pinches=pinches), HandDrive.of(simulation)))
    sunk = observation(pose(), pose(position=Q[:3] - [0.0, 0.0, 0.003]))
    commands = [loop.command(sunk) for _ in PATH.phase]
    assert commands[-1].q[2] == pytest.approx(height, abs=1e-5)


TIPPED = push_path(np.zeros(1), Q[None], motion=Motion(Turn(0.3, Y, np.zeros(3)), X, 0.03, radius=0.1), length=0.06)


def test_a_pinch_that_closes_follows_along_the_axis_of_its_tip_and_keeps_what_it_came_to(simulation):
    loop = OpenLoop()
    loop.start(PushPlan(TIPPED, replace(pressing(simulation, 4.0), pinches=True), HandDrive.of(simulation)))
    for phase, position in zip(TIPPED.phase, TIPPED.position, strict=True):
        aside = np.array([0.002, 0.003 if phase in {"approach", SQUEEZE} else -0.003, 0.002])
        told = loop.command(observation(pose(), pose(position=position + aside)))
        if phase == PUSH:
            np.testing.assert_allclose(told.q[:3] - position, [0.0, 0.003, 0.0], atol=1e-4)


@pytest.mark.parametrize(("felt", "given_up"), [(0.0, True), (0.3, True), (0.5, False), (2.0, False)])
def test_a_pinch_is_given_up_where_its_links_feel_too_little_of_what_they_should(simulation, felt, given_up):
    loop = Feedback()
    loop.start(PushPlan(TIPPED, replace(pressing(simulation, 4.0), pinches=True), HandDrive.of(simulation)))
    start, phases = pose(position=(0.0, 0.0, HEIGHT / 2)), []
    for step in range(len(TIPPED.phase)):
        palm = pose(position=TIPPED.position[step])
        told = loop.command(observation(TIPPED.displacement[step] @ start, palm, force=4.0 * felt))
        if told is None:
            break
        phases.append(told.phase)
    assert phases.count(SQUEEZE) == np.count_nonzero(TIPPED.phase == SQUEEZE)
    assert (phases.count(PUSH) < 10) == given_up


def test_a_pinch_is_not_given_up_once_it_pulls_for_what_it_holds_would_fall(simulation):
    loop, turn = Feedback(), stage_ends(TIPPED)[0]
    loop.start(PushPlan(TIPPED, replace(pressing(simulation, 4.0), pinches=True), HandDrive.of(simulation)))
    start, phases = pose(position=(0.0, 0.0, HEIGHT / 2)), []
    for step in range(len(TIPPED.phase)):
        palm, force = pose(position=TIPPED.position[step]), 4.0 if step <= turn + 10 else 0.3 * 4.0
        if (told := loop.command(observation(TIPPED.displacement[step] @ start, palm, force=force))) is None:
            break
        phases.append(told.phase)
    assert phases.count(PUSH) > 0.9 * np.count_nonzero(TIPPED.phase == PUSH)


def test_a_correction_turns_the_hand_about_the_object(simulation):
    """An object that lies turned by a little is answered by a palm that turns against it, fingers and all."""
    loop = Feedback()
    _, witness = pushed(simulation, pressing(simulation, 4.0), loop)
    loop._aim[5] = 0.05
    before, seen = witness.commands[-1], witness.seen[-1]
    after = loop._corrected(before, len(PATH.phase) - 1)
    turned = (
        Rotation.from_quat(after.quaternion, scalar_first=True)
        * Rotation.from_quat(before.quaternion, scalar_first=True).inv()
    )
    assert turned.magnitude() > 0.04
    assert after.q.shape == (ROOT_COORDINATES + 2,)
    assert seen.T_world_object is not None


WHOLE = Command(np.zeros(11), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(8), "push")


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ([], "commanded []; expected a Command, or None when the push is over"),
        (
            WHOLE._replace(ctrl=np.zeros(7)),
            "commanded a `ctrl` that is float64 of shape (7,); expected an array of 8 numbers",
        ),
        (
            WHOLE._replace(quaternion="level"),
            "commanded a `quaternion` that is 'level'; expected an array of 4 numbers",
        ),
        (
            WHOLE._replace(q=np.full(11, np.nan)),
            "commanded a `q` beyond 1e+06, or NaN; expected 11 finite numbers",
        ),
        (WHOLE._replace(ctrl=np.full(8, 1e300)), "commanded a `ctrl` beyond 1e+06, or NaN; expected 8 finite numbers"),
        (
            WHOLE._replace(quaternion=np.full(4, 1e-200)),
            "commanded a `quaternion` of length 0; expected one of length 1",
        ),
        (WHOLE._replace(phase=3), "commanded the `phase` 3; expected its name"),
        (WHOLE._replace(phase="\ud800"), "commanded the `phase` '\\ud800'; expected its name"),
    ],
)
def test_what_is_no_command_is_refused(command, message):
    check_command(WHOLE, OpenLoop(), coordinates=11, motors=8)
    with pytest.raises(InputError) as refused:
        check_command(command, OpenLoop(), coordinates=11, motors=8)
    assert str(refused.value) == f"the policy OpenLoop {message}"
