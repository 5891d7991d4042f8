"""Turns and slides of an object, on their own and in a scene."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dexnudge.errors import SceneError
from dexnudge.scenes.motion import Motion, Turn
from dexnudge.scenes.scene import Scene

UP = np.array([0.0, 0.0, 1.0])
ANGLE = (
    "expected a number of radians from 0.00175 (0.1 deg) to pi; turn the other way round for more, or by the opposite axis "
    "for less than 0"
)
QUARTER = Turn(np.pi / 2, UP, np.zeros(3))


@pytest.fixture
def scene() -> Scene:
    """A box of 120 x 60 x 20 mm on a plate, to turn by 90 degrees about its middle and to slide 50 mm along x."""
    pose = np.eye(4)
    pose[2, 3] = 0.01
    plate = trimesh.creation.box(
        extents=(1.0, 1.0, 0.02), transform=trimesh.transformations.translation_matrix([0, 0, -0.01])
    )
    box = trimesh.creation.box(extents=(0.12, 0.06, 0.02))
    return Scene(box, plate, pose, np.array([1.0, 0.0, 0.0]), motion_length=0.05, turn=QUARTER)


def test_the_way_of_a_turn_is_the_arc_of_the_farthest_point(scene: Scene) -> None:
    motion, radius = scene.object_motion, np.hypot(0.06, 0.03)
    assert motion.radius == pytest.approx(radius)
    assert motion.length == pytest.approx(np.pi / 2 * radius + 0.05)
    assert motion.beginnings == [0.0, pytest.approx(np.pi / 2 * radius)]
    corner = np.array([0.06, 0.03, 0.0, 1.0])
    np.testing.assert_allclose((motion.displacement(motion.turn_length) @ corner)[:3], [-0.03, 0.06, 0.0], atol=1e-12)
    np.testing.assert_allclose((motion.displacement(motion.length) @ corner)[:3], [0.02, 0.06, 0.0], atol=1e-12)


@pytest.mark.parametrize("way", [0.0, 0.03, 0.08, 0.12])
def test_the_twist_is_the_derivative_of_the_displacement(scene: Scene, way: float) -> None:
    motion, step = scene.object_motion, 1e-6
    vertices = trimesh.transform_points(scene.object_mesh.vertices, scene.T_world_object)
    here, there = (trimesh.transform_points(vertices, motion.displacement(at)) for at in (way, way + step))
    velocity = motion.twist(way).velocity(here)
    np.testing.assert_allclose((there - here) / step, velocity, atol=1e-4)
    assert np.linalg.norm(velocity, axis=1).max() == pytest.approx(1.0)


def test_a_carried_scene_goes_on_where_it_is(scene: Scene) -> None:
    half = scene.carried(scene.object_motion.turn_length / 2)
    assert half.turn is not None
    assert half.turn.angle == pytest.approx(np.pi / 4)
    end = half.object_motion.displacement(half.object_motion.length) @ half.T_world_object
    whole = scene.object_motion.displacement(scene.object_motion.length) @ scene.T_world_object
    np.testing.assert_allclose(end, whole, atol=1e-12)
    turned = scene.carried(scene.object_motion.turn_length)
    assert turned.turn is None
    assert turned.object_motion.length == scene.motion_length


def test_the_way_bounds_hold_the_object_all_along(scene: Scene) -> None:
    low, high = scene.way_bounds()
    for way in np.linspace(0.0, scene.object_motion.length, 57):
        points = trimesh.transform_points(scene.carried(way).object_in_world().vertices, np.eye(4))
        assert (points >= low - 5e-4).all()
        assert (points <= high + 5e-4).all()


def test_a_turn_survives_its_file(scene: Scene, tmp_path: Path) -> None:
    scene.save(tmp_path)
    turn = Scene.load(tmp_path).turn
    assert turn is not None
    assert turn.to_json() == QUARTER.to_json()


@pytest.mark.parametrize(
    ("angle", "axis", "point", "message"),
    [
        (0.0, UP, np.zeros(3), f"the angle of a turn is 0.0; {ANGLE}"),
        (1e-320, UP, np.zeros(3), f"the angle of a turn is 1e-320; {ANGLE}"),
        (float("nan"), UP, np.zeros(3), f"the angle of a turn is nan; {ANGLE}"),
        (3.2, UP, np.zeros(3), f"the angle of a turn is 3.2; {ANGLE}"),
        (np.float64(90.0), UP, np.zeros(3), f"the angle of a turn is 90.0; {ANGLE}"),
        (10**399, UP, np.zeros(3), f"the angle of a turn is an integer of 400 digits; {ANGLE}"),
        (True, UP, np.zeros(3), f"the angle of a turn is True; {ANGLE}"),
        ("1", UP, np.zeros(3), f"the angle of a turn is '1'; {ANGLE}"),
        (None, UP, np.zeros(3), f"the angle of a turn is None; {ANGLE}"),
        (1j, UP, np.zeros(3), f"the angle of a turn is 1j; {ANGLE}"),
        (np.ones(2), UP, np.zeros(3), f"the angle of a turn is array([1., 1.]); {ANGLE}"),
        (1.0, [0, 0, 0], np.zeros(3), "the axis of a turn is zero; expected a direction, such as (0, 0, 1)"),
        (1.0, ["0", "0", "1"], np.zeros(3), "the axis of a turn is ['0', '0', '1']; expected three numbers"),
        (1.0, [0, 0, True], np.zeros(3), "the axis of a turn is [0, 0, True]; expected three numbers"),
        (1.0, UP, [0, math.inf, 0], "the point of a turn is [0, inf, 0]; expected three finite numbers"),
        (1.0, UP, [0, 1e4, 0], "the point of a turn is [0, 10000.0, 0]; expected metres, at most 1000 from the origin"),
    ],
)
def test_a_turn_that_is_none_is_refused(angle, axis, point, message):
    with pytest.raises(SceneError) as refused:
        Turn.from_json({"angle": angle, "axis": axis, "point": point})
    assert str(refused.value) == message


@pytest.mark.parametrize("size", [5e-324, 1e-170, 1e160, 1e200, 1e308])
def test_an_axis_of_any_length_is_the_same_direction(size):
    np.testing.assert_array_equal(Turn(1.0, np.array([0, size, 0]), np.zeros(3)).axis, [0, 1, 0])
    np.testing.assert_allclose(
        Turn(1.0, np.array([0, size, size]), np.zeros(3)).axis, [0, np.sqrt(0.5), np.sqrt(0.5)], rtol=1e-15
    )


@pytest.mark.parametrize("content", [5, {"angle": 1.0}])
def test_a_file_without_a_proper_turn_is_refused(content: object) -> None:
    with pytest.raises(SceneError, match=r"turn"):
        Turn.from_json(content)


def test_next_to_nothing_of_a_turn_is_none(scene: Scene) -> None:
    motion = scene.object_motion
    almost = motion.turn_length - 1e-4 * motion.radius
    assert scene.carried(almost).turn is None
    assert replace(scene, motion_length=0.0).carried(almost).turn is scene.turn


def test_an_axis_out_of_reach_is_refused(scene: Scene) -> None:
    with pytest.raises(SceneError, match=r"the axis of the turn is 49\.9 m from the object; expected at most 2 m"):
        Scene(
            scene.object_mesh,
            scene.environment_mesh,
            scene.T_world_object,
            scene.motion,
            turn=Turn(1.0, UP, np.array([50.0, 0.0, 0.0])),
        )


def test_a_motion_of_no_length_needs_a_turn(scene: Scene) -> None:
    with pytest.raises(SceneError, match=r"`motion_length` is 0\.0; expected a finite number > 0"):
        Scene(scene.object_mesh, scene.environment_mesh, scene.T_world_object, scene.motion, motion_length=0.0)


@pytest.mark.parametrize("turn", [None, QUARTER])
def test_a_slide_too_short_to_see_is_refused(scene: Scene, turn: Turn | None) -> None:
    with pytest.raises(SceneError) as refused:
        replace(scene, motion_length=1e-300, turn=turn)
    assert str(refused.value) == "`motion_length` is 1e-300 m; expected at least 0.001 m"


def test_a_motion_seen_from_another_frame_moves_the_same_points_alike():
    motion = Motion(
        Turn(0.7, np.array([0.2, 0.1, 1.0]), np.array([0.1, -0.2, 0.3])), np.array([0.6, 0.8, 0.0]), 0.05, 0.1
    )
    T = Turn(1.1, np.array([1.0, 2.0, 3.0]), np.array([0.3, 0.2, 0.1])).transform(0.9)
    for way in (0.0, 0.03, motion.turn_length, motion.length):
        expected = T @ motion.displacement(way) @ np.linalg.inv(T)
        np.testing.assert_allclose(motion.moved(T).displacement(way), expected, atol=1e-12)


def test_beginning_twists_are_velocities_of_the_object_as_it_lies():
    """Of a point that is carried to where the slide begins and back: by finite differences."""
    motion = Motion(
        Turn(0.7, np.array([0.0, 0.0, 1.0]), np.array([0.1, -0.2, 0.0])), np.array([1.0, 0.0, 0.0]), 0.05, 0.1
    )
    place, step = np.array([0.15, 0.02, 0.01, 1.0]), 1e-6
    for way, twist in zip(motion.beginnings, motion.beginning_twists, strict=True):
        here, there = motion.displacement(way), motion.displacement(way + step)
        velocity = (np.linalg.inv(here) @ there @ place - place)[:3] / step
        np.testing.assert_allclose(twist.velocity(place[:3]), velocity, atol=1e-4)
