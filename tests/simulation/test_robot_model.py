"""Arm, hand and scene in one model: every link where kinematics has it, and surroundings as far as the arm reaches."""

import mujoco
import numpy as np
import pytest
import torch
import trimesh

from dexnudge.arms.registry import panda
from dexnudge.arms.robot import Robot
from dexnudge.errors import InputError
from dexnudge.hands.registry import load_hand
from dexnudge.scenes.boxes import box
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.model import ENVIRONMENT_SIDE, HAND_SIDE
from dexnudge.simulation.robot_model import load_robot_model, robot_model


@pytest.fixture(scope="module")
def robot(gripper):
    stand, mount = np.eye(4), np.eye(4)
    stand[:3, :3] = trimesh.transformations.rotation_matrix(np.pi, (0, 0, 1))[:3, :3]
    stand[:3, 3], mount[2, 3] = (0.6, 0.0, 0.0), 0.03
    return Robot(panda().standing_at(stand), load_hand(gripper), mount)


@pytest.fixture(scope="module")
def scene(block):
    """The block on a table that is no body but a sheet, and a sheet behind the arm, 0.9 m from the block."""
    pose = np.eye(4)
    pose[2, 3] = -float(block.bounds[0, 2])
    table = box((-1.0, -1.0, -0.04), (1.0, 1.0, 0.0))
    wall = trimesh.Trimesh(
        [(0.95, -0.2, 0.3), (0.95, 0.2, 0.3), (0.95, 0.2, 0.8), (0.95, -0.2, 0.8)], [[0, 2, 1], [0, 3, 2]]
    )
    return Scene(block, trimesh.util.concatenate([table, wall]), pose, np.array([1.0, 0.0, 0.0]))


@pytest.fixture(scope="module")
def model(robot, scene):
    return robot_model(robot, scene)


def test_every_link_stands_where_kinematics_has_it(robot, model):
    position = np.random.default_rng(0).uniform(robot.limits.lower, robot.limits.upper)
    model.place(position)
    data = model.simulation.data
    np.testing.assert_allclose(model.positions(data.qpos[None])[0], position, atol=1e-12)
    poses = robot.body.forward_kinematics(torch.as_tensor(robot.coordinates(position[None])))[0].numpy()
    for name, pose in zip(robot.body.link_names, poses, strict=True):
        np.testing.assert_allclose(data.body(name).xpos, pose[:3, 3], atol=1e-6)
        np.testing.assert_allclose(data.body(name).xmat.reshape(3, 3), pose[:3, :3], atol=1e-6)


def test_the_arm_meets_surroundings_far_from_the_object(robot, model):
    """Turned round by half a turn from home, the arm reaches through the sheet behind its base."""
    position = np.concatenate([robot.arm.home, np.zeros(robot.hand.num_joints)])
    touched = []
    for turn in (0.0, 2.8):
        position[0] = turn
        model.place(position)
        data, side = model.simulation.data, model.simulation.side
        sides = [set(side[pair].tolist()) for pair in np.asarray(data.contact.geom).reshape(-1, 2)]
        touched.append({HAND_SIDE, ENVIRONMENT_SIDE} in sides)
    assert touched == [False, True]


def test_nothing_but_motors_acts_on_the_robot(robot, model):
    mj = model.simulation.model
    assert mj.nmocap == 0
    assert mj.njnt == len(robot.joint_names) + 1  # the last is the object's
    assert mj.nu == len(robot.joint_names) - len(robot.hand.couplings)


def test_a_model_of_another_robot_is_refused(robot, model):
    with pytest.raises(InputError, match="is not that of Robot: "):
        load_robot_model("<mujoco><worldbody/></mujoco>", robot)
    again = load_robot_model(model.simulation.xml, robot)
    np.testing.assert_array_equal(again.simulation.model.body_mass, model.simulation.model.body_mass)
    with pytest.raises(InputError, match="expected its links"):
        load_robot_model("no xml", robot)
    assert mujoco.mj_name2id(again.simulation.model, mujoco.mjtObj.mjOBJ_BODY, "palm") > 0
