"""Depths along a plan that runs into things on purpose, known by hand."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from dexnudge.trajectories.interpolation import at
from dexnudge.trajectories.plan import JointTrajectory
from dexnudge.trajectories.plan_penetration import STEP, object_poses, plan_penetrations

LENGTH = 0.05  # [m] of the plan's push


@pytest.fixture(scope="module")
def found(block_plan):
    return plan_penetrations(block_plan)


def dipped(plan, depth, *, start=0.25, seconds=0.03):
    """The plan, whose gantry goes down and up again between two samples of a contact phase."""
    trajectory = plan.trajectory
    add = start + seconds * np.array([0.0, 0.5, 1.0])
    place = int(np.searchsorted(trajectory.time, start))
    rows = {}
    for name in ("position", "velocity", "acceleration", "effort"):
        values = getattr(trajectory, name)
        extra = np.repeat(values[place - 1 : place], 3, axis=0)
        if name == "position":
            extra[1, 1] -= depth
        rows[name] = np.insert(values, [place] * 3, extra, axis=0)
    return replace(plan, trajectory=JointTrajectory(time=np.insert(trajectory.time, [place] * 3, add), **rows))


def test_a_dip_of_milliseconds_through_the_table_is_found(block_plan, block_scene, found):
    robot, table = block_plan.robot, block_scene.environment_mesh.bounds[1, 2]
    plan = dipped(block_plan, 0.03)
    positions = robot.coordinates(plan.trajectory.position)
    poses = robot.body.forward_kinematics(torch.as_tensor(positions))[3].numpy()
    pads = [robot.body.link_names.index(name) for name in ("pad0", "pad1")]
    lowest = min(trimesh.transform_points(robot.body.link_meshes[pad].vertices, poses[pad])[:, 2].min() for pad in pads)
    assert table - lowest > 0.002
    through = plan_penetrations(plan)
    deeper = through.environment - found.greatest["environment"]  # what holds the pads is in the slab anyway
    worst = through.time[through.environment.argmax()]
    assert deeper.max() > 0.002
    assert worst == pytest.approx(0.265, abs=0.002)
    assert through.greatest["environment"] == pytest.approx(table - lowest, abs=STEP)


def test_the_object_is_looked_for_where_it_is_at_that_time(block_plan, found):
    """A pad is in a block that stands 5 mm aside from the end of the second phase on; before, it is not."""
    assert found.greatest["object"] < 0.001
    aside = block_plan.scene.T_world_object.copy()
    aside[1, 3] += 0.005
    early, later = block_plan.phases[:2], block_plan.phases[2:]
    plan = replace(block_plan, phases=(*early, *(replace(phase, T_world_object=aside) for phase in later)))
    moved = plan_penetrations(plan)
    end = plan.phases[1].end
    assert moved.object[moved.time < end].max() < 0.001
    assert moved.object[(moved.time > end) & (moved.time < plan.phases[2].end)].max() == pytest.approx(0.005, abs=5e-4)


def test_the_object_goes_along_with_the_palm(block_plan):
    start = block_plan.scene.T_world_object
    carried = start.copy()
    carried[0, 3] += LENGTH
    at_end = ("push", "retreat")
    phases = tuple(
        replace(phase, T_world_object=carried if phase.name in at_end else start) for phase in block_plan.phases
    )
    time = np.array([0.0, 0.8, 1.55, 2.3, 2.9])
    palms = block_plan.robot.palm_poses(at(block_plan.trajectory, time).position)
    poses = object_poses(replace(block_plan, phases=phases), time, palms)
    assert poses[:, 0, 3] == pytest.approx([0.0, 0.0, LENGTH / 2, LENGTH, LENGTH], abs=1e-9)
    assert np.allclose(poses[:, :3, :3], np.eye(3))


def test_what_stands_still_is_measured_once_and_what_moves_at_every_fifth_of_a_millimetre(block_plan, found):
    assert not ((found.time > 0.45) & (found.time < 0.75)).any()  # forces are built up
    places = block_plan.robot.palm_poses(at(block_plan.trajectory, found.time).position)[:, 0, 3]
    pushed = (found.time >= 0.9) & (found.time <= 2.2)
    assert np.abs(np.diff(places[pushed])).max() < 2 * STEP
