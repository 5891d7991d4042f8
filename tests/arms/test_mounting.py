"""How a hand sits on a flange: against geometry measured here, and mounts that cannot be."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

import dexnudge as dn
from dexnudge.arms.mounting import BRACKETS, DEEPEST, GAP, MAKERS, WEDGES

from .made_up import LIMITS, joint, link, six_axis_urdf

HANDS = ("shadow_lite", "allegro", "panda_gripper")
OVER = np.diag([1.0, -1.0, -1.0, 1.0])  # the hand's head over heels


@pytest.fixture(scope="module")
def panda():
    return dn.load_arm("panda")


@pytest.fixture(scope="module", params=HANDS)
def robot(panda, request):
    return dn.mount(panda, dn.load_hand(request.param))


def hand_points(robot, position):
    """Points of the hand in the flange's frame."""
    body, links = robot.body, len(robot.arm.tree.links)
    poses = body.forward_kinematics(torch.as_tensor(robot.coordinates(position[None])))[0].numpy()
    T_flange_world = np.linalg.inv(robot.arm.flange_poses(position[None, : robot.arm.num_joints])[0])
    placed = zip(body.link_meshes[links:], T_flange_world @ poses[links:], strict=True)
    return np.concatenate([trimesh.transform_points(mesh.vertices, pose) for mesh, pose in placed])


def test_the_forearm_is_the_base_of_arm_and_hand_too(robot):
    assert robot.body.base_link == robot.hand.base_link


def test_the_hand_continues_the_flange_and_does_not_reach_behind_it(robot):
    rest = np.concatenate([robot.arm.home, robot.hand.apart])
    points = hand_points(robot, rest)
    pair = (robot.arm.name, robot.hand.name)
    if pair in MAKERS:
        return
    turn, tilt, out = BRACKETS.get(pair, (*WEDGES.get(pair, (0.0, 0.0)), None))
    beside = points[np.linalg.norm(points[:, :2], axis=1) < 0.1] if out else points  # the thumb hangs down farther out
    assert beside[:, 2].min() == pytest.approx(GAP, abs=1e-6)
    flange = robot.arm.flange_poses(robot.arm.home[None])[0]
    tips = robot.hand.fingertip_links
    poses = robot.body.forward_kinematics(torch.as_tensor(robot.coordinates(rest[None])))[0].numpy()
    fingers = [tip for number, tip in enumerate(tips) if number != robot.hand.thumb]
    middle = np.mean([poses[robot.body.link_names.index(tip), :3, 3] for tip in fingers], axis=0)
    middle -= poses[robot.body.link_names.index(robot.mount), :3, 3] - flange[:3, 3]
    way = flange[:3, :3].T @ (middle - flange[:3, 3])
    turn, tilt = np.radians([turn, tilt])
    axis = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    if out:
        assert (points @ axis).min() == pytest.approx(
            out * np.sin(tilt) + robot.T_flange_mount[2, 3] * np.cos(tilt), abs=1e-3
        )
    assert way @ axis / np.linalg.norm(way) > np.cos(np.radians(40.0))  # the Lite's palm is tilted by 40 deg itself


def test_a_mount_of_ones_own_is_kept(panda):
    hand = dn.load_hand("allegro")
    T = dn.default_mount(panda, hand)
    T[:3, 3] += [0.0, 0.0, 0.1]
    robot = dn.mount(panda, hand, T.tolist())
    np.testing.assert_allclose(robot.T_flange_mount, T)
    column = robot.body.link_meshes[robot.body.link_names.index("panda_link8")]
    np.testing.assert_allclose(column.bounds[:, 2], [0.0, 0.1], atol=1e-9)  # what holds the hand out there


@pytest.mark.parametrize("name", ["shadow_lite", "allegro"])
def test_a_mount_that_turns_the_hand_into_the_arm_is_refused_with_the_links(panda, name):
    hand = dn.load_hand(name)
    with pytest.raises(
        dn.ArmError, match=r"turns the hand into the arm: '.*' \d+ mm into 'panda_link\d'.* mend `mount`"
    ):
        dn.mount(panda, hand, OVER @ dn.default_mount(panda, hand))


def test_the_makers_gripper_fits_as_the_maker_mounts_it_and_nowhere_deeper(panda):
    gripper = dn.load_hand("panda_gripper")
    assert dn.mount(panda, gripper, MAKERS["panda", "panda_gripper"]).T_flange_mount[2, 3] == 0.0
    deeper = MAKERS["panda", "panda_gripper"] @ trimesh.transformations.translation_matrix([0, 0, -2 * DEEPEST])
    with pytest.raises(dn.ArmError, match=r"'panda_hand' .* mm into 'panda_link7'"):
        dn.mount(panda, gripper, deeper)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (np.eye(3), r"T_flange_mount has shape \(3, 3\)"),
        (2 * np.eye(4), "T_flange_mount is not a rigid transform"),
        (np.full((4, 4), np.nan), "NaN"),
        ("palm", "T_flange_mount is not a matrix of numbers"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "mirrors"),
    ],
)
def test_what_is_no_rigid_pose_is_refused(panda, given, message):
    with pytest.raises(dn.ArmError, match=message):
        dn.mount(panda, dn.load_hand("allegro"), given)


def test_the_body_carries_the_hand_where_the_hand_says(robot):
    generator = np.random.default_rng(0)
    position = generator.uniform(robot.limits.lower, robot.limits.upper, (5, len(robot.joint_names)))
    body = robot.body.forward_kinematics(torch.as_tensor(robot.coordinates(position))).numpy()
    q = robot.configurations(position)
    hand = robot.hand.forward_kinematics(torch.as_tensor(q)).numpy()
    tips = robot.hand.fingertip_links
    ours = body[:, [robot.body.link_names.index(tip) for tip in tips]]
    np.testing.assert_allclose(ours, hand[:, [robot.hand.link_names.index(tip) for tip in tips]], atol=1e-9)
    np.testing.assert_allclose(
        robot.flange_poses(q), robot.arm.flange_poses(position[:, : robot.arm.num_joints]), atol=1e-9
    )


def test_a_base_stands_where_it_is_put(panda):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.2, 0.9]).as_matrix()
    T[:3, 3] = [0.4, -0.1, 0.8]
    there = dn.load_arm("panda", base=T)
    at_home = panda.flange_poses(panda.home[None])[0]
    np.testing.assert_allclose(there.flange_poses(there.home[None])[0], T @ at_home, atol=1e-12)
    with pytest.raises(dn.ArmError, match="T_world_base"):
        dn.load_arm("panda", base=np.ones((4, 4)))


SIDEWAYS = '<link name="ee"/>' + joint("ee_mount", "l6", "ee", ("0 0 0.06", "0 1.5707963 0"), "", "fixed")


def test_along_the_last_joint_where_the_flange_does_not_point_out(described):
    arm = dn.load_arm(described(six_axis_urdf(extra=SIDEWAYS), {"flange": "ee", "home": [0.1] * 6, "limits": LIMITS}))
    straight = dn.load_arm(described(six_axis_urdf(), {"flange": "tool0", "home": [0.1] * 6, "limits": LIMITS}))
    hand = dn.load_hand("allegro")
    fingers = [
        robot.T_flange_mount[:3, :3] @ hand.finger_axis for robot in (dn.mount(arm, hand), dn.mount(straight, hand))
    ]
    np.testing.assert_allclose(fingers, [[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-3)


def test_a_hand_stands_in_front_of_what_reaches_beyond_the_flange(described):
    collar = link("collar", "0.1 0.1 0.04") + joint("collar_mount", "l6", "collar", ("0 0 0.1", "0 0 0"), "", "fixed")
    arm = dn.load_arm(described(six_axis_urdf(extra=collar), {"flange": "tool0", "home": [0.1] * 6, "limits": LIMITS}))
    robot = dn.mount(arm, dn.load_hand("allegro"))
    points = hand_points(robot, np.concatenate([arm.home, robot.hand.apart]))
    assert 0.055 < points[:, 2].min() < 0.07  # the collar ends 60 mm in front of the flange


def test_an_arm_of_the_same_name_with_another_flange_has_no_bracket(panda):
    hand = dn.load_hand("shadow_lite")
    other = replace(panda, flange="panda_link7")
    turned = [dn.default_mount(arm, hand)[:3, :3] @ hand.palm_normal for arm in (panda, other)]
    assert not np.allclose(*turned, atol=0.1)
