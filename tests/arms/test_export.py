"""A robot written to a folder and read by others: yourdfpy, MuJoCo and pinocchio put every link where it is."""

import warnings

import mujoco
import numpy as np
import pytest
import torch
import yourdfpy
from scipy.spatial.transform import Rotation

from dexnudge.arms.export import ARM_DAMPING_TIME, export_robot, robot_actuators, robot_drives
from dexnudge.arms.registry import panda
from dexnudge.arms.robot import Robot
from dexnudge.hands.registry import load_hand

HANDS = ("shadow_lite", "panda_gripper")  # joints on shared tendons, a base behind the palm; joints that slide, a mimic


@pytest.fixture(scope="module", params=HANDS)
def robot(request):
    stand, mount = np.eye(4), np.eye(4)
    stand[:3, :3] = Rotation.from_euler("xyz", [0.1, -0.2, 2.0]).as_matrix()
    stand[:3, 3] = (0.3, -0.5, 0.1)
    mount[:3, 3] = (0.0, 0.01, 0.02)
    return Robot(panda().standing_at(stand), load_hand(request.param), mount)


@pytest.fixture(scope="module")
def urdf(robot, tmp_path_factory):
    return export_robot(robot, tmp_path_factory.mktemp("robot"))


@pytest.fixture(scope="module")
def position(robot):
    return np.random.default_rng(0).uniform(robot.limits.lower, robot.limits.upper)


@pytest.fixture(scope="module")
def links(robot, position):
    poses = robot.body.forward_kinematics(torch.as_tensor(robot.coordinates(position[None])))[0].numpy()
    return dict(zip(robot.body.link_names, poses, strict=True))


@pytest.mark.parametrize("file", ["robot.urdf", "robot.xml"])
def test_mujoco_puts_every_link_where_it_is(robot, urdf, position, links, file):
    model = mujoco.MjModel.from_xml_path(str(urdf.with_name(file)))
    data = mujoco.MjData(model)
    for joint in robot.body.joints:
        if joint is not None and joint.index is not None:
            value = joint.multiplier * position[joint.index] + joint.offset
            data.qpos[model.joint(joint.name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    for name, pose in links.items():
        np.testing.assert_allclose(data.body(name).xpos, pose[:3, 3], atol=1e-9)
        np.testing.assert_allclose(data.body(name).xmat.reshape(3, 3), pose[:3, :3], atol=1e-9)


def test_yourdfpy_reads_the_joints_in_order_and_every_link_where_it_is(robot, urdf, position, links):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # yourdfpy calls what trimesh is about to remove
        read = yourdfpy.URDF.load(str(urdf))
    assert read.base_link == "world"
    assert tuple(read.actuated_joint_names) == robot.joint_names
    read.update_cfg(position)
    for name, pose in links.items():
        np.testing.assert_allclose(read.get_transform(name, "world"), pose, atol=1e-9)
    for name, *values in zip(robot.joint_names, *vars(robot.limits).values(), strict=True):
        lower, upper, velocity, _, _, effort = values
        limit = read.joint_map[name].limit
        assert (limit.lower, limit.upper, limit.velocity, limit.effort) == pytest.approx(
            (lower, upper, velocity, effort)
        )


def test_pinocchio_puts_every_link_where_it_is(robot, urdf, position, links):
    pinocchio = pytest.importorskip("pinocchio")
    model = pinocchio.buildModelFromUrdf(str(urdf))
    data = model.createData()
    order = [joint for joint in robot.body.joints if joint is not None and joint.index is not None]
    values = {joint.name: joint.multiplier * position[joint.index] + joint.offset for joint in order}
    pinocchio.framesForwardKinematics(model, data, np.array([values[name] for name in list(model.names)[1:]]))
    for name, pose in links.items():
        np.testing.assert_allclose(data.oMf[model.getFrameId(name)].homogeneous, pose, atol=1e-9)


def test_every_motor_of_the_mjcf_is_a_servo_whose_damping_the_plan_knows(robot, urdf):
    model = mujoco.MjModel.from_xml_path(str(urdf.with_name("robot.xml")))
    motors = robot_actuators(robot)
    assert [model.actuator(index).name for index in range(model.nu)] == [motor.name for motor in motors]
    assert {name for motor in motors for name in motor.joints} == set(robot.joint_names)
    for index, motor in enumerate(motors):
        assert model.actuator_gainprm[index, 0] == motor.kp
        assert model.actuator_biasprm[index, 1:3] == pytest.approx((-motor.kp, -motor.own_kv))
        damping = [model.dof_damping[model.joint(name).dofadr[0]] for name in motor.joints]
        assert motor.kv == pytest.approx(motor.own_kv + np.mean(damping) / len(damping))
        if index < robot.arm.num_joints:
            assert motor.kv / motor.kp == pytest.approx(ARM_DAMPING_TIME)
        assert model.actuator_forcerange[index] == pytest.approx((-motor.effort, motor.effort))
    assert not model.actuator_ctrllimited.any()
    assert not model.dof_damping[: robot.arm.num_joints].any()


def test_servos_hold_the_robot_against_gravity_without_sagging(robot, urdf):
    model = mujoco.MjModel.from_xml_path(str(urdf.with_name("robot.xml")))
    data = mujoco.MjData(model)
    start = np.concatenate([robot.arm.home, np.clip(0.1, robot.hand.lower, robot.hand.upper)])
    where = dict(zip(robot.joint_names, start, strict=True))
    for joint in robot.body.joints:
        if joint is not None and joint.index is not None:
            data.joint(joint.name).qpos = joint.multiplier * start[joint.index] + joint.offset
    data.ctrl = [sum(where[name] * part for name, part in motor.joints.items()) for motor in robot_actuators(robot)]
    for _ in range(250):
        mujoco.mj_step(model, data)
    held = np.array([data.joint(name).qpos[0] for name in robot.arm.joint_names])
    np.testing.assert_allclose(held, robot.arm.home, atol=1e-4)


def test_drives_of_the_arm_are_its_published_limits(robot):
    drives, count = robot_drives(robot), robot.arm.num_joints
    np.testing.assert_array_equal(drives.effort[:count], robot.arm.limits.effort)
    np.testing.assert_array_equal(drives.velocity[:count], robot.arm.limits.velocity)


def test_a_link_called_world_is_refused(robot):
    from dataclasses import replace

    from dexnudge.errors import ArmError

    tree = robot.arm.tree
    joints = tuple(replace(joint, parent=joint.parent.replace("panda_link0", "world")) for joint in tree.joints)
    links = {name.replace("panda_link0", "world"): mesh for name, mesh in tree.links.items()}
    arm = replace(robot.arm, tree=replace(tree, links=links, joints=joints))
    with pytest.raises(ArmError, match="has a link 'world'"):
        export_robot(Robot(arm, robot.hand, robot.T_flange_mount), "never")
