"""Plans: whole, within limits, clean at every moment, and carried out; and what has none says why."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

import dexnudge as dn
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.trajectories.interpolation import at
from dexnudge.trajectories.plan import PHASES
from dexnudge.trajectories.planner import Planner

MOST_DEEP = 0.001  # [m]


@pytest.fixture(scope="module")
def carrier(boxy_hand):
    """The Panda, half a metre behind the block."""
    return dn.mount(
        dn.load_arm("panda").standing_at(trimesh.transformations.translation_matrix((-0.55, 0, 0))), boxy_hand
    )


@pytest.fixture(scope="module")
def scene():
    """A block of 160 x 80 x 20 mm on a floor."""
    floor = trimesh.creation.box(bounds=[[-0.4, -0.4, -0.02], [0.4, 0.4, 0.0]])
    place = trimesh.transformations.translation_matrix((0.0, 0.0, 0.01))
    return dn.Scene(
        trimesh.creation.box((0.16, 0.08, 0.02)), floor, place, np.array([1.0, 0.0, 0.0]), motion_length=0.06
    )


@pytest.fixture(scope="module")
def pressing():
    """q with both fingertips 0.3 mm above the block."""
    return np.array([0.0, 0.0, 0.02 + 0.073 + 0.0003, 1, 0, 0, 0, 1, 0, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def planned(carrier, scene, pressing):
    found = Planner(scene, carrier)(pressing, configuration=5)
    assert isinstance(found, dn.Plan), found
    return found


def test_phases_follow_each_other_from_home_to_home(planned, carrier, scene):
    assert tuple(phase.name for phase in planned.phases) == PHASES[:5]
    assert planned.phases[0].start == 0.0
    assert planned.phases[-1].end == pytest.approx(planned.trajectory.time[-1])
    assert all(one.end == other.start for one, other in zip(planned.phases[:-1], planned.phases[1:], strict=True))
    assert {phase.configuration for phase in planned.phases} == {5}
    for end in (0, -1):
        np.testing.assert_allclose(planned.trajectory.position[end, :7], carrier.arm.home, atol=1e-6)
        assert not planned.trajectory.velocity[end].any()
        assert not planned.trajectory.effort[end].any()
    moved = planned.phases[-1].T_world_object - scene.T_world_object
    np.testing.assert_allclose(moved[:3, 3], planned.length * scene.motion, atol=1e-9)
    np.testing.assert_allclose(planned.phases[2].T_world_object, scene.T_world_object)


def test_no_limit_is_exceeded_at_any_millisecond(planned):
    """By finite differences of the positions, which know nothing of how the trajectory was made."""
    trajectory, limits = planned.trajectory, planned.robot.limits
    time = np.arange(trajectory.time[0], trajectory.time[-1], 0.001)
    position = at(trajectory, time).position
    assert (position >= limits.lower - 1e-6).all()
    assert (position <= limits.upper + 1e-6).all()
    rate = position
    for name in ("velocity", "acceleration", "jerk"):
        rate = np.diff(rate, axis=0) / 0.001
        assert (np.abs(rate).max(axis=0) <= getattr(limits, name) * 1.001 + 1e-6).all(), name


def test_the_object_moves_straight_and_slowly(planned, scene):
    push = next(phase for phase in planned.phases if phase.name == "push")
    joints = at(planned.trajectory, np.linspace(push.start, push.end, 200))
    palm = planned.robot.palm_poses(joints.position)[:, :3, 3]
    assert np.abs((palm - palm[0]) @ scene.motion).max() == pytest.approx(planned.length, rel=0.01)
    speed = np.linalg.norm(np.diff(palm, axis=0), axis=1) / ((push.end - push.start) / 199)
    assert speed.max() < 0.055
    assert np.abs(np.delete(palm - palm[0], np.abs(scene.motion).argmax(), axis=1)).max() < 0.003


def test_nothing_penetrates_at_any_moment(planned, scene):
    """Points of all links against exact distances, every 10 ms; the object goes with the push."""
    robot, body = planned.robot, planned.robot.body
    push = next(phase for phase in planned.phases if phase.name == "push")
    start = robot.palm_poses(at(planned.trajectory, np.array([push.start])).position)[0, :3, 3]
    floor, block = ExactDistance(scene.environment_mesh), ExactDistance(scene.object_in_world())
    dense = body.dense_points
    for time, position in zip(planned.trajectory.time, planned.trajectory.position, strict=True):
        poses = body.forward_kinematics(torch.as_tensor(robot.coordinates(position[None])))[0].numpy()[dense.link]
        points = np.einsum("pij,pj->pi", poses[:, :3, :3], dense.points) + poses[:, :3, 3]
        shift = np.zeros(3)
        if time > push.start:
            now = min(time, push.end)
            palm = robot.palm_poses(at(planned.trajectory, np.array([now])).position)[0, :3, 3]
            shift = ((palm - start) @ scene.motion) * scene.motion
        assert floor(points).distance.min() > -MOST_DEEP
        assert block(points - shift).distance.min() > -MOST_DEEP, time


def test_forces_are_there_where_the_hand_presses_and_nowhere_else(planned):
    time, effort = planned.trajectory.time, planned.trajectory.effort
    for phase in planned.phases:
        inside = (time > phase.start + 1e-6) & (time < phase.end - 1e-6)
        if phase.name in ("pre-contact", "contact"):
            assert not effort[inside].any()
            assert not phase.link_force
        if phase.name == "push":
            assert (np.abs(effort[inside]).max(axis=1) > 0.05).all()
            assert min(phase.link_force.values()) > 0.05


def test_it_is_carried_out_by_the_motors_of_arm_and_hand(planned):
    episode = planned.execute()
    assert episode.success, episode
    assert episode.length_reached > 0.8 * planned.length


def test_the_same_question_has_the_same_answer(planned, carrier, scene, pressing):
    again = Planner(scene, carrier)(pressing, configuration=5)
    np.testing.assert_array_equal(again.trajectory.position, planned.trajectory.position)


def test_a_push_beyond_reach_says_how_far_it_comes(carrier, scene, pressing):
    far = carrier.arm.standing_at(trimesh.transformations.translation_matrix((-0.655, 0, 0)))
    found = Planner(replace(scene, motion_length=0.15), replace(carrier, arm=far))(pressing)
    assert isinstance(found, dn.Failure)
    assert found.phase == "push"
    assert "out of reach after" in found.reason
    assert found.reason.endswith("of 150 mm")


def test_a_wall_in_the_way_of_the_hand_is_named(carrier, scene, pressing):
    wall = trimesh.creation.box(bounds=[[0.05, -0.4, 0.03], [0.07, 0.4, 0.5]])
    blocked = replace(scene, environment_mesh=trimesh.util.concatenate([scene.environment_mesh, wall]))
    found = Planner(blocked, carrier)(pressing)
    assert isinstance(found, dn.Failure)
    assert (found.phase, found.configuration) == ("push", 0)
    assert "into the surroundings" in found.reason


def test_a_base_that_cannot_be_is_refused(carrier, scene):
    inside = carrier.arm.standing_at(trimesh.transformations.translation_matrix((-0.3, 0.0, -0.02)))
    with pytest.raises(dn.ArmError, match="stands in what is around it"):
        Planner(scene, replace(carrier, arm=inside))
    away = carrier.arm.standing_at(trimesh.transformations.translation_matrix((5.0, 0.0, 0.5)))
    with pytest.raises(dn.ArmError, match="out of reach"):
        Planner(scene, replace(carrier, arm=away))


def test_an_arm_keeps_from_its_limits_where_its_home_does(planned):
    arm, limits = planned.robot.arm.num_joints, planned.robot.arm.limits
    position = planned.trajectory.position[:, :arm]
    assert (position >= limits.lower + 0.0199).all()
    assert (position <= limits.upper - 0.0199).all()


def test_a_slow_plan_is_the_same_plan_slower(planned, carrier, scene, pressing):
    slow = Planner(scene, carrier, speed=0.25)(pressing)
    fastest = np.abs(slow.trajectory.velocity).max(axis=0)
    assert (fastest[:7] <= 0.25 * carrier.arm.limits.velocity).all()
    assert slow.trajectory.duration > 2.5 * planned.trajectory.duration
    np.testing.assert_allclose(slow.trajectory.position[-1], planned.trajectory.position[-1], atol=1e-6)
