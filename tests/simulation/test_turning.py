"""Objects that turn and tip: a block turned by two pads, a tall one tipped about its edge, against closed forms."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError
from dexnudge.execution.scene_rollout import SceneRollout
from dexnudge.execution.slide_grasp_lift import check_slides_at_last
from dexnudge.mechanics.balance import balance_problem
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.sliding_task import GRAVITY, sliding_task
from dexnudge.planning.object_path import check_slides, push_length, stations
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.boxes import box
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts
from dexnudge.simulation.hand_path import PUSH, SPEED, PushPath, push_path
from dexnudge.simulation.model import SimulationModel, scene_model
from dexnudge.simulation.push_forces import PushForces, push_forces
from dexnudge.simulation.rollout import Rollout, Trace
from dexnudge.simulation.success import judge_push

WIDE, HIGH = 0.04, 0.12  # [m] of the tall block, which stands on a table
MASS = 0.15
Z = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def turning(block_scene) -> Scene:
    """The block between the pads, to be turned by 90 degrees about its centre."""
    return replace(block_scene, turn=Turn(np.pi / 2, Z, np.zeros(3)), motion_length=0.0)


@pytest.fixture(scope="module")
def tipping() -> Scene:
    """The tall block, to be tipped forward by 15 degrees about the lower edge of its front, at x = 0."""
    pose = np.eye(4)
    pose[:3, 3] = -WIDE / 2, 0.0, HIGH / 2
    table = box((-0.5, -0.3, -0.04), (0.5, 0.3, 0.0))
    turn = Turn(np.radians(15.0), np.array([0.0, 1.0, 0.0]), np.zeros(3))
    tall = trimesh.creation.box((WIDE, 0.06, HIGH))
    return Scene(tall, table, pose, np.array([1.0, 0.0, 0.0]), motion_length=0.0, turn=turn)


@pytest.fixture(scope="module")
def behind() -> HandContacts:
    """A palm flat against the upper part of the tall block's back."""
    points = np.array([[-WIDE, y, z] for y in (-0.01, 0.01) for z in (0.08, 0.10)])
    return HandContacts(points=points, normals=np.tile([-1.0, 0.0, 0.0], (4, 1)), link=np.zeros(4, dtype=np.int64))


@pytest.fixture(scope="module")
def pushing(pad_hand, tipping, behind) -> PushForces:
    q = np.array([-0.06, 0.0, 0.19, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    way = stations(tipping, push_length(tipping))
    return push_forces(scene_model(pad_hand, tipping), q, behind, way, sliding_task(tipping))


@pytest.fixture(scope="module")
def turned(pad_hand, turning, pad_grasp) -> tuple[Rollout, PushPath, PushForces]:
    q, contacts = pad_grasp
    palm = trimesh.creation.box((0.1, 0.1, 0.1))  # 1 kg: a base of some grams would be flung around by what it presses
    palm.apply_translation((0.0, 0.0, -0.1))
    hand = replace(pad_hand, link_meshes=(palm, *pad_hand.link_meshes[1:]))
    simulation, length = scene_model(hand, turning), push_length(turning)
    forces = push_forces(simulation, q, contacts, stations(turning, length), sliding_task(turning))
    path = push_path(np.zeros(1), q[None], motion=turning.object_motion, length=length)
    rollout = Rollout(simulation, q)
    rollout.push(path, forces)
    return rollout, path, forces


def test_the_hand_goes_around_the_axis_with_the_objects_fastest_point_at_its_speed(turned, turning):
    _, path, _ = turned
    turn, radius = turning.turn, np.hypot(0.03, 0.02)  # of the block's corners
    speed = np.linalg.norm(path.velocity[:, 3:], axis=1)
    assert speed.max() * radius == pytest.approx(SPEED, rel=1e-3)
    first, last = (Rotation.from_quat(path.quaternion[row], scalar_first=True) for row in (0, -1))
    np.testing.assert_allclose((last * first.inv()).as_rotvec(), turn.angle * turn.axis, atol=1e-9)
    np.testing.assert_allclose(path.displacement[-1], turn.transform(turn.angle), atol=1e-9)


def test_two_pads_turn_a_block(turned, turning):
    rollout, _, _ = turned
    motion = turning.object_motion
    verdict = judge_push(rollout.trace, motion=motion, length=motion.length, max_normal_force=5.0, diverged=False)
    assert verdict.success
    assert verdict.angle_asked == pytest.approx(np.pi / 2)
    assert verdict.angle_reached == pytest.approx(np.pi / 2, abs=np.radians(2.0))
    assert verdict.length_asked == 0.0
    assert verdict.turned_deg < 2.0
    rotation = rollout.T_world_object[:3, :3]
    np.testing.assert_allclose(rotation @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=np.radians(2.0))


def test_the_press_of_the_pads_turns_with_them(turned):
    """Their torques stay what they were at the beginning, and so does what they press with."""
    rollout, _, forces = turned
    np.testing.assert_allclose(forces.motor_torque, np.tile(forces.motor_torque[0], (len(forces.done), 1)), atol=0.02)
    trace = rollout.trace
    moving = trace.phase == PUSH
    wanted = -np.einsum("pcx,cx->p", forces.force, np.repeat([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]], 4, axis=0))
    assert trace.hand_object_force[moving, 0].mean() == pytest.approx(wanted.mean(), rel=0.1)


def test_an_object_that_turns_is_carried_by_its_corners_and_not_by_sides_that_bulge_a_little(turning):
    """Carried half way along its sides it would be turned by half the force; nothing says that it is."""
    outline = [(0.03, 0.02), (0.0, 0.021), (-0.03, 0.02), (-0.03, -0.02), (0.0, -0.021), (0.03, -0.02)]
    bulging = trimesh.convex.convex_hull([[x, y, z] for x, y in outline for z in (-0.02, 0.02)])
    sliding = replace(turning, object_mesh=bulging, turn=None, motion_length=0.1)
    assert len(support_contacts(sliding).points) == 6
    carried = support_contacts(replace(turning, object_mesh=bulging)).points
    np.testing.assert_allclose(np.linalg.norm(carried[:, :2], axis=1), np.hypot(0.03, 0.02), atol=1e-6)
    assert len(carried) == 4


def test_what_is_left_of_a_turn_is_what_the_object_has_not_made(turned, turning):
    rollout, _, _ = turned
    first = replace(turning, motion_length=0.05)
    assert SceneRollout(first, rollout.simulation).scene_now() is first
    assert SceneRollout(first, rollout.simulation, rollout).scene_now().turn is None
    asked = replace(first, turn=replace(turning.turn, angle=np.pi))
    stage = SceneRollout(asked, rollout.simulation, rollout)
    left = stage.scene_now().turn
    assert left.angle == pytest.approx(np.pi / 2, abs=np.radians(2.0))
    np.testing.assert_allclose(left.axis, Z)
    np.testing.assert_allclose(stage.scene_now().T_world_object, rollout.T_world_object)


def test_what_only_slides_refuses_a_turn(turning, tipping):
    with pytest.raises(
        InputError, match=r"turns the object by 90 deg; expected a slide alone: an arm turns or tips no"
    ):
        check_slides(turning, "an arm")
    check_slides(replace(turning, turn=None, motion_length=0.1), "an arm")
    check_slides_at_last(replace(turning, motion_length=0.1))
    for scene in (turning, replace(tipping, motion_length=0.05)):
        with pytest.raises(InputError, match=r"ends with a turn, or tips the object; expected one that slides it"):
            check_slides_at_last(scene)


def motion_of(scene: Scene, made: np.ndarray) -> Trace:
    """A trace in which the object has made these ways [m] of the motion, record after record."""
    poses = np.stack([scene.object_motion.displacement(way) @ scene.T_world_object for way in made])
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(scalar_first=True)
    empty, count = np.zeros((len(made), 0)), len(made)
    return Trace(
        time=0.02 * np.arange(count),
        phase=np.array(["settle"] + ["push"] * (count - 1)),
        attempt=np.ones(count, dtype=np.int64),
        qpos=empty,
        ctrl=empty,
        mocap=empty,
        object_pose=np.concatenate([poses[:, :3, 3], quaternions], axis=1),
        hand_object_force=np.zeros((count, 2)),
        link_force=np.zeros((count, 1)),
        motor_force=empty,
        torque_share=empty,
        base_wrench=np.zeros((count, 6)),
        hand_environment_clearance=np.ones(count),
        hand_environment_depth=np.zeros(count),
        support_force=np.ones(count),
    )


@pytest.mark.parametrize(
    ("share", "outcome"),
    [(1.0, Outcome.SUCCESS), (0.81, Outcome.SUCCESS), (0.79, Outcome.TURNED_SHORT), (1.2, Outcome.TURNED)],
)
def test_a_turn_is_judged_by_its_angle(turning, share, outcome):
    length = turning.object_motion.length
    trace = motion_of(turning, share * length * np.linspace(0.0, 1.0, 60))
    verdict = judge_push(trace, motion=turning.object_motion, length=length, max_normal_force=5.0, diverged=False)
    assert verdict.outcome is outcome
    assert verdict.angle_reached == pytest.approx(share * np.pi / 2)
    assert verdict.turned_deg == pytest.approx(max(0.0, share - 1.0) * 90.0, abs=1e-6)
    assert abs(verdict.sunk) < 1e-9


@pytest.mark.parametrize(("off", "outcome"), [(0.019, Outcome.SUCCESS), (0.021, Outcome.DRIFTED)])
def test_an_object_that_turns_stays_on_its_path(turning, off, outcome):
    motion, share = turning.object_motion, np.linspace(0.0, 1.0, 60)
    trace = motion_of(turning, motion.length * share)
    drifted = trace.object_pose.copy()
    drifted[:, :2] += off * np.sin(np.pi * share)[:, None] * np.array([0.6, 0.8])
    trace = replace(trace, object_pose=drifted)
    verdict = judge_push(trace, motion=motion, length=motion.length, max_normal_force=5.0, diverged=False)
    assert verdict.outcome is outcome
    assert verdict.aside == pytest.approx(off, rel=1e-2)


def test_a_force_that_is_no_number_is_no_success(turning):
    motion = turning.object_motion
    trace = motion_of(turning, motion.length * np.linspace(0.0, 1.0, 60))
    trace = replace(trace, link_force=np.full_like(trace.link_force, np.nan))
    verdict = judge_push(trace, motion=motion, length=motion.length, max_normal_force=5.0, diverged=False)
    assert verdict.outcome is Outcome.PRESSED_TOO_HARD


def test_half_a_turn_does_not_wrap(turning):
    scene = replace(turning, turn=Turn(np.pi, Z, np.zeros(3)))
    length = scene.object_motion.length
    verdict = judge_push(
        motion_of(scene, 1.05 * length * np.linspace(0.0, 1.0, 90)),
        motion=scene.object_motion,
        length=length,
        max_normal_force=5.0,
        diverged=False,
    )
    assert verdict.angle_reached == pytest.approx(1.05 * np.pi)
    assert verdict.success


def test_each_stage_is_judged_by_itself(tipping):
    scene = replace(tipping, motion_length=0.05)
    motion = scene.object_motion
    for slid, outcome in ((0.041, Outcome.SUCCESS), (0.039, Outcome.FELL_SHORT)):
        trace = motion_of(scene, (motion.turn_length + slid) * np.linspace(0.0, 1.0, 60))
        verdict = judge_push(trace, motion=motion, length=motion.length, max_normal_force=5.0, diverged=False)
        assert verdict.outcome is outcome
        assert verdict.length_reached == pytest.approx(slid)
        assert verdict.angle_reached == pytest.approx(verdict.angle_asked)


def test_an_object_that_is_lifted_less_than_its_tip_lifts_it_is_not_dropped_but_one_that_falls_is(tipping):
    trace = motion_of(tipping, tipping.object_motion.length * np.linspace(0.0, 1.0, 60))
    fallen = trace.object_pose.copy()
    fallen[-5:, 2] -= 0.021
    for poses, outcome in ((trace.object_pose, Outcome.SUCCESS), (fallen, Outcome.DROPPED)):
        judged = replace(trace, object_pose=poses)
        verdict = judge_push(
            judged,
            motion=tipping.object_motion,
            length=tipping.object_motion.length,
            max_normal_force=5.0,
            diverged=False,
        )
        assert verdict.outcome is outcome


@pytest.mark.parametrize(("share", "tips"), [(0.9, False), (1.05, True)])
def test_a_tall_block_tips_at_the_force_of_the_closed_form(pad_hand, tipping, share, tips):
    """F at height h over the edge: F h = m g w / 2."""
    simulation, body = scene_model(pad_hand, tipping), 0.1
    simulation.place(np.array([0.0, 0.3, 0.4, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    settle(simulation, 100)
    force = share * MASS * GRAVITY * (WIDE / 2) / body
    wrench = simulation.data.xfrc_applied[simulation.object_body]
    wrench[0], wrench[4] = force, force * (body - HIGH / 2)
    settle(simulation, 150)
    leaning = np.degrees(np.arccos(np.clip(simulation.data.xmat[simulation.object_body, 8], -1.0, 1.0)))
    assert leaning > 2.0 if tips else leaning < 0.2


def settle(simulation: SimulationModel, steps: int) -> None:
    for _ in range(steps):
        mujoco.mj_step(simulation.model, simulation.data)


def test_the_moment_about_the_edge_falls_as_the_centre_of_mass_comes_over_it(tipping, behind, pushing):
    """The pivot passes none: the hand's is m g times the horizontal way from the edge to the centre of mass."""
    reach, first = np.hypot(WIDE, HIGH) / 2, np.arctan2(HIGH, WIDE)
    moments = []
    for done, force, surplus in zip(pushing.done, pushing.force, pushing.surplus, strict=True):
        moments.append(np.cross(behind.points, force / surplus).sum(axis=0)[1])
        lever = reach * np.cos(first + done * tipping.turn.angle)
        assert moments[-1] == pytest.approx(MASS * GRAVITY * lever, abs=0.03 * MASS * GRAVITY * HIGH / 2)
    assert (np.diff(moments) < 0).all()
    assert moments[-1] < 0.3 * moments[0]


def test_what_the_base_presses_with_carries_the_object_at_every_station(tipping, pushing):
    q, no = np.array([-0.06, 0.0, 0.19]), np.zeros((0, 3))
    nothing = HandContacts(points=no, normals=no, link=np.zeros(0, dtype=np.int64))
    for each, wrench, surplus in zip(
        stations(tipping, push_length(tipping)), pushing.base_wrench, pushing.surplus, strict=True
    ):
        task, rotation = each.task(sliding_task(tipping)), each.T[:3, :3]
        palm, (force, torque) = rotation @ q + each.T[:3, 3], wrench.reshape(2, 3) @ rotation.T / surplus
        torque = torque + np.cross(palm - task.centre, force)
        hand = np.concatenate([force, torque / task.half_length]) / task.weight
        problem = balance_problem(nothing, each.supports, task)
        assert nnls((problem.support_normal + problem.support_friction).T, -hand - problem.load)[1] < 0.03


def test_a_turn_that_ends_gives_way_to_the_slides_forces(tipping):
    scene = replace(tipping, motion_length=0.03)
    motion = scene.object_motion
    found = stations(scene, motion.length)
    done = np.array([each.done for each in found])
    assert (np.diff(done) > 0).all()
    assert done[[0, -1]].tolist() == [0.0, 1.0]
    sliding = np.array([not each.twist.angular.any() for each in found])
    assert (np.diff(done)[np.diff(sliding.astype(int)) > 0] * motion.length).tolist() == pytest.approx([1e-3])
    assert np.diff(done).max() * motion.length <= 0.01 + 1e-9
