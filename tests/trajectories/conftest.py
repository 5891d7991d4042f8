"""A gantry with two pads, whose every force is known by hand, and a plan with which it carries a block along."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from dexnudge.arms.arm import Arm, JointLimits
from dexnudge.arms.robot import Robot
from dexnudge.hands.tree import Tree, TreeJoint
from dexnudge.simulation.model import scene_model
from dexnudge.trajectories.plan import JointTrajectory, Phase, Plan
from dexnudge.trajectories.pressing import press

LENGTH = 0.05  # [m] of the push
# When each of the plan's poses is reached [s], and the phase that ends there.
STAGES = ((0.2, "contact"), (0.4, "squeeze"), (0.8, "squeeze"), (2.3, "push"), (2.5, "retreat"), (2.9, "retreat"))


@pytest.fixture(scope="session")
def gantry(pad_hand, pad_grasp):
    """The pads on two slides along x and z; at zero they are at the block."""
    place, along_z = np.eye(4), np.eye(4)
    place[:3, 3], along_z[:3, 3] = pad_grasp[0][:3] + np.array([0.0, 0.0, -0.3]), (0.0, 0.0, 0.3)
    x, z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    links = {"stand": trimesh.creation.box((0.05, 0.05, 0.05)), "carriage": trimesh.creation.box((0.05, 0.05, 0.05))}
    ends = {"lower": -0.4, "upper": 0.4, "slides": True}
    joints = (
        TreeJoint("along", "stand", "carriage", np.eye(4), x, fixed=False, **ends),
        TreeJoint("up", "carriage", "flange", along_z, z, fixed=False, **ends),
    )
    limits = JointLimits(*(np.full(2, value) for value in (-0.4, 0.4, 1.0, 10.0, 100.0, 100.0)))
    tree = Tree("gantry", links | {"flange": trimesh.Trimesh()}, joints)
    arm = Arm("gantry", tree, ("along", "up"), limits, np.zeros(2), "flange", T_world_base=place)
    return Robot(arm, pad_hand, np.eye(4))


@pytest.fixture(scope="session")
def block_press(pad_hand, pad_grasp, block_scene):
    scene = replace(block_scene, max_normal_force=3.0)  # what the pads' motors can do
    return press(scene_model(pad_hand, scene), scene, pad_grasp[0], length=LENGTH)


@pytest.fixture(scope="session")
def block_plan(gantry, block_press, block_scene):
    """From open pads to the squeeze, 5 cm along x, and open again; at rest at each of its samples."""
    touching = block_press.touching[9:]
    opened, near = touching - 0.024, touching - 0.004  # 12 mm and 2 mm from the block
    fingers = np.array([opened, near, touching, touching, touching, touching, opened])
    travelled = np.array([0.0, 0.0, 0.0, 0.0, LENGTH, LENGTH, LENGTH])
    position = np.concatenate([np.stack([travelled, np.zeros(7)], axis=1), fingers], axis=1)
    loaded = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
    effort = block_press.efforts(gantry, position, loaded)
    still = np.zeros_like(position)
    time = np.array([0.0, *(end for end, _ in STAGES)])
    names = [name for _, name in STAGES]
    pushed = block_scene.T_world_object.copy()
    pushed[0, 3] += LENGTH
    _, *phases = (
        Phase(
            name,
            time[names.index(name)],
            time[len(names) - names[::-1].index(name)],
            0,
            pushed if name in ("push", "retreat") else block_scene.T_world_object,
        )
        for name in dict.fromkeys(names)
    )
    half = STAGES[0][0] / 2
    coming = (
        Phase("pre-contact", 0.0, half, 0, block_scene.T_world_object),
        Phase("contact", half, 2 * half, 0, block_scene.T_world_object),
    )
    return Plan(gantry, block_scene, JointTrajectory(time, position, still, still, effort), (*coming, *phases), LENGTH)


@pytest.fixture(scope="session")
def lift_plan(block_plan):
    """The same with the block taken once more, lifted by 10 cm and held for 2 s."""
    pushed = block_plan.trajectory
    opened, pressed = pushed.position[-1], pushed.position[3]
    touching = np.array([LENGTH, 0.0, *pressed[2:]])
    raised = touching + np.array([0.0, 0.1, 0.0, 0.0])
    position = np.array([touching, touching, raised, raised])
    effort = np.zeros_like(position)
    effort[1:, 2:] = pushed.effort[3, 2:]
    time = pushed.time[-1] + np.array([0.4, 0.8, 2.3, 4.3])
    assert opened[0] == LENGTH
    still = np.zeros_like(position)
    whole = [
        np.concatenate(pair) for pair in ((pushed.time, time), (pushed.position, position), (pushed.velocity, still))
    ]
    trajectory = JointTrajectory(*whole, whole[2], np.concatenate([pushed.effort, effort]))
    pose = block_plan.scene.T_world_object
    start, middle, end = pushed.time[-1], time[1], time[-1]
    more = (Phase("regrasp", start, middle, 0, pose), Phase("lift", middle, end, 0, pose))
    return replace(block_plan, trajectory=trajectory, phases=(*block_plan.phases, *more))
