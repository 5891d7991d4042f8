"""An arm's way to a configuration of its hand: it leads there, and nothing is touched on it."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

import dexnudge as dn
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.planning.arm_approach import OPEN, ArmApproach, NoWay, exits, stations
from dexnudge.planning.hand_clearance import PADDING
from dexnudge.planning.hand_motion import state_space
from dexnudge.planning.robot_motion import RobotClearance, RobotSpace, SelfDistance


@pytest.fixture(scope="module")
def robot(boxy_hand):
    """The Panda half a metre behind the block, on the floor."""
    return dn.mount(
        dn.load_arm("panda").standing_at(trimesh.transformations.translation_matrix((-0.55, 0, 0))), boxy_hand
    )


@pytest.fixture(scope="module")
def approach(robot, block_scene):
    return ArmApproach(robot, block_scene)


@pytest.fixture(scope="module")
def found(approach, robot, touching):
    return approach.to(touching, start=robot.arm.home)


def solid_points(robot, position):
    """Every link's dense points in the world, those of the base left out."""
    body = robot.body
    poses = body.forward_kinematics(torch.as_tensor(robot.coordinates(position[None])))[0].numpy()
    dense = body.dense_points
    kept = body.moved_links[dense.link]
    pose = poses[dense.link[kept]]
    return np.einsum("pij,pj->pi", pose[:, :3, :3], dense.points[kept]) + pose[:, :3, 3]


def test_it_leads_from_home_to_the_configuration(found, robot, touching):
    vertices, entry = found
    np.testing.assert_allclose(vertices[0][:7], robot.arm.home)
    np.testing.assert_allclose(vertices[-1], entry.exit[-1], atol=1e-9)
    np.testing.assert_allclose(entry.stretch[-1], entry.exit[0])
    (q,) = robot.configurations(entry.stretch[:1])
    np.testing.assert_allclose(q, touching, atol=2e-4)


def test_the_hand_goes_straight_at_the_end(found, robot):
    _, entry = found
    palm = robot.configurations(entry.stretch)[:, :3]
    line = palm[-1] - palm[0]
    away = palm - palm[0] - np.outer((palm - palm[0]) @ line / (line @ line), line)
    assert np.linalg.norm(line) > 0.004
    assert np.abs(away).max() < 2e-5


def test_nothing_is_touched_on_the_way(found, robot, block_scene):
    """Exact distances of all points of arm and hand, in steps of 0.02 rad."""
    vertices, entry = found
    positions = [vertices[:1]]
    for start, end in itertools.pairwise(vertices):
        count = int(np.ceil(np.abs(end - start).max() / 0.02))
        positions.append(start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - start))
    floor, block = ExactDistance(block_scene.environment_mesh), ExactDistance(block_scene.object_in_world())
    for position in np.concatenate([*positions, entry.exit[::-1]]):
        points = solid_points(robot, position)
        assert floor(points).distance.min() > 0.001
        assert block(points).distance.min() > 0.001


def test_what_is_out_of_reach_is_said(robot, block_scene, touching):
    far = replace(robot, arm=robot.arm.standing_at(trimesh.transformations.translation_matrix((-3.0, 0, 0))))
    assert ArmApproach(far, block_scene).to(touching, start=robot.arm.home) == NoWay("contact", "out of reach")


def test_a_home_that_is_taken_is_said(robot, scene_of, touching):
    home = robot.palm_poses(np.append(robot.arm.home, np.zeros(4))[None])[0, :3, 3]
    taken = scene_of([[-0.4, -0.4, -0.02], [0.4, 0.4, 0.0]], [home - 0.05, home + 0.05])
    found = ArmApproach(robot, taken).to(touching, start=robot.arm.home)
    assert isinstance(found, NoWay)
    assert found.phase == "pre-contact"
    assert "not free at home" in found.reason
    assert "the surroundings" in found.reason


def test_ways_into_the_open_are_free_and_end_there(approach, boxy_hand, block_scene, touching):
    hand = approach.hand_ways(touching)
    for way in exits(boxy_hand, block_scene, hand.waiting, seed=0):
        assert hand.waiting.check.clearances(way[:1]).distance.min() >= OPEN
        assert all(hand.waiting.check.free(one, other) for one, other in itertools.pairwise(way))


def test_in_a_closed_box_there_is_no_way_out(boxy_hand, scene_of, touching):
    low, high = np.array([-0.14, -0.12, -0.02]), np.array([0.14, 0.12, 0.16])
    walls = []
    for axis in range(3):
        for near, far in ((low[axis] - 0.02, low[axis]), (high[axis], high[axis] + 0.02)):
            bounds = np.array([low - 0.02, high + 0.02])
            bounds[:, axis] = near, far
            walls.append(bounds)
    scene = scene_of(*walls)
    robot = dn.mount(
        dn.load_arm("panda").standing_at(trimesh.transformations.translation_matrix((-0.7, 0, 0))), boxy_hand
    )
    approach = ArmApproach(robot, scene)
    found = approach.hand_ways(touching)
    assert isinstance(found, NoWay) or not [way for way in found.ways if np.abs(way[0][:3]).max() > 0.3]


def test_a_straight_motion_moves_no_point_farther_than_its_bound(robot):
    generator = np.random.default_rng(0)
    space = RobotSpace(robot, state_space(robot.hand, np.zeros(4)))
    limits = robot.arm.limits
    for _ in range(20):
        start = np.append(generator.uniform(limits.lower, limits.upper), generator.uniform())
        end = start + generator.normal(scale=0.1, size=8)
        way = np.linalg.norm(
            np.diff([solid_points(robot, one) for one in space.positions(np.array([start, end]))], axis=0), axis=2
        )
        assert way.max() <= space.displacement(start, end) + 1e-9


def test_clearance_is_that_of_the_nearest_point_and_an_arm_counts_as_thicker(robot, block_scene):
    measure, home = RobotClearance(robot, block_scene), np.append(robot.arm.home, np.zeros(4))
    low = home.copy()
    low[1] = 0.5
    arm = RobotClearance(robot, block_scene, hand=False)
    floor = ExactDistance(block_scene.environment_mesh)
    base = robot.arm.T_world_base
    for position in (home, low):
        given = base[None, :3, 3], base[None, :3, :3], position[None]
        points = solid_points(robot, position)
        of_arm = np.isin(robot.body.dense_points.link, range(9))[robot.body.moved_links[robot.body.dense_points.link]]
        exact = floor(points).distance
        nearest = min(exact[of_arm].min() - PADDING, exact[~of_arm].min())
        assert measure(*given).distance[0, 0] == pytest.approx(min(nearest, 0.1), rel=0.25, abs=1e-4)
        assert arm(*given).distance[0, 0] == pytest.approx(min(exact[of_arm].min() - PADDING, 0.1), rel=0.25, abs=1e-4)


def test_links_in_each_other_are_seen(crane, boxy_hand):
    """The crane's beam bends back until it meets its column; the distance is that of their boxes' corners and sides."""
    robot = dn.mount(crane, boxy_hand, trimesh.transformations.translation_matrix((0.0, 0.0, 0.1)))
    distance = SelfDistance(robot, most=0.5)
    apart = np.concatenate([crane.home, np.zeros(4)])
    body = robot.body
    for bend in (0.4, 1.2, -1.5):
        apart[2] = bend
        poses = body.forward_kinematics(torch.as_tensor(robot.coordinates(apart[None])))[0].numpy()
        one, other = body.link_names.index("stand"), body.link_names.index("beam")
        placed = [body.link_meshes[link].copy().apply_transform(poses[link]) for link in (one, other)]
        points = trimesh.sample.sample_surface(placed[1], 4000, seed=0)[0]
        assert distance(apart) <= ExactDistance(placed[0])(points).distance.min() + 1e-6
    assert distance(apart) > 0
    assert all(distance.nearest(apart))


def test_an_arm_follows_a_line_and_says_where_it_is_lost(robot, touching, approach):
    solved = approach.solutions(touching)
    assert len(solved) >= 2
    count = 400
    q = np.repeat(touching[None], count, axis=0)
    q[:, 0] += np.linspace(0.0, 1.0, count)
    positions, reached = approach.followed(q[None], solved[:1])
    assert 50 < reached[0] < count
    np.testing.assert_allclose(robot.configurations(positions[0, : reached[0]]), q[: reached[0]], atol=2e-4)


def test_stations_are_as_near_as_asked(approach, touching):
    hand = approach.hand_ways(touching)
    rows = stations(hand.waiting.check.space, hand.ways[0], spacing=0.01)
    np.testing.assert_allclose(rows[[0, -1]], hand.ways[0][[0, -1]])
    steps = [hand.waiting.check.space.displacement(one, other) for one, other in itertools.pairwise(rows)]
    assert max(steps) <= 0.01 + 1e-9
