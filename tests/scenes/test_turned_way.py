"""The way of an object that turns: against closed forms, and against the overlap of the whole bodies."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from dexnudge.geometry.overlap import deepest_overlap
from dexnudge.objects.builtin import builtin_object
from dexnudge.scenes.boxes import box
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.free_way import free_way
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.placement import surroundings_distance
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts

LENGTH, WIDTH, HEIGHT = 0.12, 0.06, 0.02
RADIUS, DIAGONAL = np.hypot(LENGTH, WIDTH) / 2, np.arctan2(WIDTH, LENGTH)
FLOOR = box((-0.4, -0.4, -0.02), (0.4, 0.4, 0.0))
UP = np.array([0.0, 0.0, 1.0])
DEEP = 1e-3  # [m] that is allowed


def turning(*others, turn=None, floor=FLOOR, slide=0.0, height=0.0):
    """A box on a floor, its middle above the origin, that is to turn by a right angle, and whatever else there is."""
    pose = trimesh.transformations.translation_matrix([0.0, 0.0, height + HEIGHT / 2])
    turn = Turn(np.pi / 2, UP, np.zeros(3)) if turn is None else turn
    environment = trimesh.util.concatenate([floor, *others])
    body = trimesh.creation.box((LENGTH, WIDTH, HEIGHT))
    return Scene(body, environment, pose, np.array([1.0, 0.0, 0.0]), motion_length=slide, turn=turn)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("gap", [0.002, 0.004])
def test_a_corner_meets_a_wall_after_the_angle_of_the_closed_form(sign, gap):
    wall = box((LENGTH / 2 + gap, -0.3, 0.0), (0.2, 0.3, 0.03))
    found = free_way(turning(wall, turn=Turn(np.pi / 2, sign * UP, np.zeros(3))))
    expected = DIAGONAL - np.arccos((LENGTH / 2 + gap + DEEP) / RADIUS)
    assert found.angle * RADIUS == pytest.approx(expected * RADIUS, abs=1e-3)
    assert not found.whole
    assert found.height == pytest.approx(0.03, abs=1e-4)
    assert found.place[1] * sign < 0  # the corner that is ahead


def test_what_is_told_of_it():
    wall = box((LENGTH / 2 + 0.004, -0.3, 0.0), (0.2, 0.3, 0.03))
    assert str(free_way(turning())) == "free for 90 deg"
    assert str(free_way(turning(slide=0.05))) == "free for 90 deg and 50 mm"
    assert str(free_way(turning(wall))).startswith("blocked after 12 deg by something 30 mm high at (0.06")
    turned = Turn(np.pi / 2, UP, np.array([-LENGTH / 2, 0.0, 0.0]))  # then it stands out to x = -0.03, y = 0.12
    ahead = box((0.06, 0.10, 0.0), (0.08, 0.20, 0.03))
    told = str(free_way(turning(ahead, turn=turned, slide=0.1)))
    assert told.startswith("blocked after 90 deg and 90 mm by something 30 mm high at (0.060"), told


def test_a_thin_post_before_a_large_side_is_met():
    post = box((-0.0003, WIDTH / 2 + 0.004, 0.0), (0.0003, WIDTH / 2 + 0.0046, 0.1))
    found = free_way(turning(post, turn=Turn(np.pi / 2, UP, np.array([-LENGTH / 2, -WIDTH / 2, 0.0]))))
    assert not found.whole
    assert 0 < np.degrees(found.angle) < 8


@pytest.mark.parametrize(("sign", "whole"), [(1.0, True), (-1.0, False)])
def test_a_box_turns_away_from_a_wall_that_it_touches_and_not_into_it(sign, whole):
    wall = box((-0.3, -WIDTH / 2 - 0.02, 0.0), (0.3, -WIDTH / 2, 0.05))
    pivot = np.array([-LENGTH / 2, -WIDTH / 2, 0.0])
    found = free_way(turning(wall, turn=Turn(np.pi / 2, sign * UP, pivot)))
    assert found.whole == whole
    if not whole:
        assert str(found).startswith("blocked after 0 mm by") or str(found).startswith("blocked by what it touches at")


def test_a_tip_over_a_block_ends_at_the_floor_below():
    block = box((-0.2, -0.2, 0.0), (0.01, 0.2, 0.02))  # the box stands out by 50 mm, 20 mm above the floor
    tip = Turn(np.radians(60.0), np.array([0.0, 1.0, 0.0]), np.array([0.01, 0.0, 0.02]))
    found = free_way(turning(block, turn=tip, height=0.02))
    expected = np.arcsin((0.02 + DEEP) / (LENGTH / 2 - 0.01))
    assert found.angle == pytest.approx(expected, abs=1e-3 / 0.05)
    assert free_way(turning(block, turn=replace(tip, angle=np.radians(20.0)), height=0.02)).whole


def test_a_tip_through_the_support_is_blocked():
    tip = Turn(0.5, np.array([0.0, 1.0, 0.0]), np.zeros(3))  # about the middle of its underside
    assert str(free_way(turning(turn=tip))).startswith("blocked by what it touches at (0.060,")


@pytest.mark.parametrize(("family", "name", "options"), [
    ("corner", "remote-003", {"turn_deg": 40.0, "about": (-0.5, -0.3, 0.0)}),
    ("clutter", "phone-003", {"turn_deg": -90.0}),
    ("shelf", "box-004", {"turn_deg": 120.0}),
    ("book", "remote-003", {}),
])  # fmt: skip
def test_the_whole_bodies_overlap_where_it_ends_and_not_before(family, name, options):
    scene = build_scene(family, builtin_object(name), seed=3, **options, motion_length=0.0 if options else 0.06)
    motion, found = scene.object_motion, free_way(scene)
    surroundings = surroundings_distance(scene.environment_mesh)

    def depth(way):
        placed = scene.object_mesh.copy()
        placed.apply_transform(motion.displacement(way) @ scene.T_world_object)
        return deepest_overlap(placed, surroundings)[0]

    end = min(found.length, motion.turn_length)
    assert not found.touching
    assert max(depth(way) for way in np.linspace(0.0, max(end - 0.001, 0.0), 12)) <= DEEP + 1e-5
    if not found.whole:
        assert depth(end + 0.001) > DEEP


def test_contacts_of_a_rim_are_there_to_turn_about():
    block = box((-0.2, -0.2, 0.0), (0.0105, 0.2, 0.02))
    tip = Turn(0.3, np.array([0.0, 1.0, 0.0]), np.array([0.0105, 0.0, 0.02]))
    scene = turning(block, turn=tip, height=0.02)
    assert support_contacts(scene).points[:, 0].max() == pytest.approx(0.0105, abs=1e-6)
    assert support_contacts(replace(scene, turn=None, motion_length=0.1)).points[:, 0].max() < 0.0125
    tilted = support_contacts(scene.carried(scene.object_motion.turn_length / 2))
    np.testing.assert_allclose(tilted.points[:, 0], 0.0105, atol=0.01)
