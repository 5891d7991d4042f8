"""Where an arm stands in a scene."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import dexnudge as dn
from dexnudge.arms.standing import DISTANCE, check_base, standing_mesh


@pytest.fixture(scope="module")
def robot():
    return dn.mount(dn.load_arm("panda"), dn.load_hand("allegro"))


@pytest.fixture(scope="module")
def table():
    return dn.build_scene("table", "phone", seed=0)


def at(robot, T):
    return replace(robot, arm=robot.arm.standing_at(T))


def pose(x, y, z):
    return trimesh.transformations.translation_matrix([x, y, z])


@pytest.mark.parametrize("family", ["table", "shelf"])
def test_the_arm_looks_at_the_object_from_where_it_goes(robot, family):
    scene = dn.build_scene(family, "phone", seed=1)
    T = dn.default_base(robot.arm, scene)
    bounds = scene.object_in_world().bounds
    way = T[:3, 3] - bounds.mean(axis=0)
    motion = np.append(scene.motion[:2], 0.0) / np.linalg.norm(scene.motion[:2])
    assert T[2, 3] == pytest.approx(bounds[0, 2])
    assert DISTANCE - 1e-9 <= np.linalg.norm(way[:2]) <= 1.2
    np.testing.assert_allclose(way[:2] / np.linalg.norm(way[:2]), motion[:2], atol=1e-9)
    np.testing.assert_allclose(T[:3, 0], -motion, atol=1e-9)
    np.testing.assert_allclose(T[:3, 2], [0, 0, 1], atol=1e-12)
    check_base(at(robot, T), scene)


def test_the_base_moves_outward_past_what_stands_there(robot, table):
    bounds = table.object_in_world().bounds
    spot = bounds.mean(axis=0) + DISTANCE * table.motion
    pillar = trimesh.creation.box((0.1, 0.1, 1.0), transform=trimesh.transformations.translation_matrix(spot))
    crowded = replace(table, environment_mesh=trimesh.util.concatenate([table.environment_mesh, pillar]))
    T = dn.default_base(robot.arm, crowded)
    assert np.linalg.norm((T[:3, 3] - bounds.mean(axis=0))[:2]) > DISTANCE + 0.1
    check_base(at(robot, T), crowded)


def test_surroundings_without_room_are_refused(robot, table):
    block = trimesh.creation.box((5.0, 5.0, 1.0), transform=pose(0, 0, 0.55))
    with pytest.raises(dn.ArmError, match=r"finds no place: .*`arm_base`"):
        dn.default_base(robot.arm, replace(table, environment_mesh=block))


def test_a_base_inside_the_table_is_refused_with_place_and_depth(robot, table):
    low, high = table.environment_mesh.bounds
    x, y = (low + high)[:2] / 2
    with pytest.raises(dn.ArmError, match=r"stands in what is around it: \d+ mm deep at \(.*\); .*`arm_base`"):
        check_base(at(robot, pose(x, y, (high[2] + low[2]) / 2)), table)


def test_a_base_without_geometry_may_not_stand_in_the_table_either(robot, table):
    links = {**robot.arm.tree.links, "panda_link0": trimesh.Trimesh()}
    bare = replace(robot, arm=replace(robot.arm, tree=replace(robot.arm.tree, links=links)))
    low, high = table.environment_mesh.bounds
    x, y = (low + high)[:2] / 2
    with pytest.raises(dn.ArmError, match="stands in what is around it"):
        check_base(at(bare, pose(x, y, (high[2] + low[2]) / 2)), table)


def test_a_base_in_the_object_is_refused(robot, table):
    with pytest.raises(dn.ArmError, match="stands in what is around it"):
        check_base(at(robot, table.T_world_object), table)


def test_an_object_out_of_reach_is_said(robot, table):
    with pytest.raises(
        dn.ArmError, match=r"out of reach: \d\.\d\d m from the base of 'panda', expected at most 1\.\d\d m"
    ):
        check_base(at(robot, pose(3.0, 0.0, 0.0)), table)


def test_the_reach_is_that_of_the_farthest_of_many_joint_angles(robot):
    arm = robot.arm
    angles = np.random.default_rng(5).uniform(arm.limits.lower, arm.limits.upper, (20_000, 7))
    far = np.linalg.norm(arm.flange_poses(angles)[:, :3, 3], axis=1).max()
    assert far <= arm.reach <= far + 0.05


def test_what_stands_is_the_link_at_the_base(robot):
    T = pose(1.0, 2.0, 0.0)
    np.testing.assert_allclose(
        standing_mesh(robot.arm.standing_at(T)).bounds, robot.arm.tree.links["panda_link0"].bounds + T[:3, 3]
    )
