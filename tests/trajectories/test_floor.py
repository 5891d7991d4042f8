"""A floor keeps arm and hand above it all along a plan, and bears base and object."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

import dexnudge as dn
from dexnudge.arms.standing import SIDE, THICKNESS, with_floor
from dexnudge.trajectories.plan import below_base
from dexnudge.trajectories.planner import Planner

MOST_DEEP = 0.001  # [m]
PRESSING = np.array(
    [0.0, 0.0, 0.02 + 0.073 + 0.0003, 1, 0, 0, 0, 1, 0, 0.0, 0.0, 0.0, 0.0]
)  # tips 0.3 mm over the block
HOME = np.array([0.87, 1.55, -0.88, -2.97, 0.39, 2.71, 0.89])  # above the floor; the short way from here dips below it
FLOOR = -0.02  # [m]
SHIFT = trimesh.transformations.translation_matrix


@pytest.fixture(scope="module")
def carrier(boxy_hand):
    """The Panda on the floor, half a metre behind the block."""
    arm = dn.load_arm("panda").standing_at(SHIFT((-0.55, 0, FLOOR)))
    return dn.mount(replace(arm, home=HOME), boxy_hand)


@pytest.fixture(scope="module")
def scene():
    """A block of 160 x 80 x 20 mm on a small table."""
    table = trimesh.creation.box(bounds=[[-0.2, -0.2, -0.02], [0.2, 0.2, 0.0]])
    block = trimesh.creation.box((0.16, 0.08, 0.02))
    return dn.Scene(block, table, SHIFT((0, 0, 0.01)), np.array([1.0, 0.0, 0.0]), motion_length=0.03)


def lowest(plan):
    """Lowest surface point of the links that move, at any 10 ms, by the hands' own points rather than hulls."""
    robot, body = plan.robot, plan.robot.body
    dense = body.dense_points
    moving = dense.link > body.link_names.index("panda_link0")
    poses = body.forward_kinematics(torch.as_tensor(robot.coordinates(plan.trajectory.position))).numpy()
    link, points = dense.link[moving], dense.points[moving]
    return min(float((np.einsum("pj,pj->p", pose[link, 2, :3], points) + pose[link, 2, 3]).min()) for pose in poses)


def test_no_point_of_arm_and_hand_comes_below_the_floor(carrier, scene):
    without = Planner(scene, carrier)(PRESSING)
    assert isinstance(without, dn.Plan), without
    assert lowest(without) < FLOOR - 0.02
    assert below_base(without) == pytest.approx(FLOOR - lowest(without), abs=0.001)
    found = Planner(with_floor(scene, carrier.arm, FLOOR), carrier)(PRESSING)
    assert isinstance(found, dn.Plan), found
    assert lowest(found) > FLOOR - MOST_DEEP
    assert below_base(found) < MOST_DEEP
    assert found.execute().success  # the simulation has the floor, too


def test_the_floor_joins_the_surroundings_below_the_base(carrier, scene):
    made = with_floor(scene, carrier.arm, FLOOR).environment_mesh
    assert made.body_count == 2
    slab = made.split()[1]
    low, high = slab.bounds
    np.testing.assert_allclose(high, [-0.55 + SIDE / 2, SIDE / 2, FLOOR])
    np.testing.assert_allclose(low, [-0.55 - SIDE / 2, -SIDE / 2, FLOOR - THICKNESS])
    assert made.volume == pytest.approx(scene.environment_mesh.volume + SIDE**2 * THICKNESS)


def test_a_measured_world_knows_that_its_floor_was_not_seen(carrier, scene):
    around = scene.environment_mesh.copy()
    around.metadata["origin"] = np.zeros(len(around.faces), dtype=np.int8)
    made = with_floor(replace(scene, environment_mesh=around), carrier.arm, FLOOR).environment_mesh
    np.testing.assert_array_equal(made.metadata["origin"], [0] * 12 + [1] * 12)
    assert len(around.metadata["origin"]) == 12


@pytest.mark.parametrize(("floor", "what"), [(0.05, "the object"), (-0.01, "the base of 'panda'")])
def test_a_floor_in_which_something_stands_is_refused(carrier, scene, floor, what):
    with pytest.raises(dn.ArmError, match=f"`floor` is {floor:g} m, .* mm above the underside of {what}"):
        with_floor(scene, carrier.arm, floor)


@pytest.mark.parametrize("floor", [np.nan, np.inf, 1e300])
def test_a_floor_that_is_no_height_is_refused(carrier, scene, floor):
    with pytest.raises(dn.InputError, match="expected the height of its top"):
        with_floor(scene, carrier.arm, floor)
