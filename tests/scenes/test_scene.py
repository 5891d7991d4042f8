"""The scene's own rules, with the texts that a user sees."""

import dataclasses

import numpy as np
import pytest
import trimesh

from dexnudge.errors import SceneError
from dexnudge.geometry.rigid import rigid_transform
from dexnudge.scenes.motion import unit_motion
from dexnudge.scenes.scene import Scene


@pytest.fixture
def scene() -> Scene:
    slab = trimesh.creation.box((1, 1, 0.1))
    slab.apply_translation([0, 0, -0.05])
    pose = np.eye(4)
    pose[2, 3] = 0.005
    return Scene(trimesh.creation.box((0.15, 0.07, 0.01)), slab, pose, np.array([0.0, 3.0, 0.0]))


def test_the_defaults_are_those_of_the_conventions(scene):
    assert (scene.friction_hand, scene.friction_environment, scene.mass) == (0.8, 0.4, 0.15)
    assert (scene.max_normal_force, scene.motion_length) == (5.0, 0.10)
    np.testing.assert_array_equal(scene.motion, [0, 1, 0])


def test_the_object_in_the_world_is_moved_by_the_pose(scene):
    np.testing.assert_allclose(scene.object_in_world().bounds, [[-0.075, -0.035, 0], [0.075, 0.035, 0.01]])
    np.testing.assert_allclose(scene.object_mesh.bounds[1, 2], 0.005)


@pytest.mark.parametrize(
    ("motion", "expected"),
    [
        ([0, 0, 0], "motion is (0, 0, 0); expected a finite direction that is not zero, such as (1, 0, 0)"),
        (
            [0, float("inf"), 0],
            "motion is (0, inf, 0); expected a finite direction that is not zero, such as (1, 0, 0)",
        ),
        ([1, 0], "motion has shape (2,); expected three numbers (dx, dy, dz)"),
    ],
)
def test_a_motion_that_is_no_direction(motion, expected):
    with pytest.raises(SceneError) as caught:
        unit_motion(motion)
    assert str(caught.value) == expected


def test_poses_that_are_not_rigid():
    def message_of(value) -> str:
        with pytest.raises(SceneError) as caught:
            rigid_transform(value)
        return str(caught.value)

    mirrored, scaled, projective = np.diag([1.0, 1, -1, 1]), np.diag([2.0, 2, 2, 1]), np.eye(4)
    projective[3, 0] = 0.5
    expected = "expected a rotation (tolerance 0.001, det 1) and last row [0, 0, 0, 1]; "
    ending = expected + "scale the mesh, not the pose"
    projective[0, 3] = 0.1
    transposed = np.eye(4)
    transposed[3, 0] = 0.5
    assert message_of(mirrored) == (
        "T_world_object is not a rigid transform: |R^T R - I| = 0, det R = -1, last row [0.0, 0.0, 0.0, 1.0]; "
        + expected
        + "it mirrors: was it written in a left-handed frame?"
    )
    assert message_of(transposed).endswith("; transposed? the translation belongs into the last column")
    rounded = trimesh.transformations.rotation_matrix(0.7, (1.0, 2.0, 3.0)).round(2)
    assert message_of(rounded).endswith("; was it rounded? write its numbers with four decimals or more")
    assert message_of(scaled) == (
        "T_world_object is not a rigid transform: |R^T R - I| = 3, det R = 8, last row [0.0, 0.0, 0.0, 1.0]; " + ending
    )
    assert message_of(projective) == (
        "T_world_object is not a rigid transform: |R^T R - I| = 0, det R = 1, last row [0.5, 0.0, 0.0, 1.0]; " + ending
    )
    assert message_of(np.eye(3)) == "T_world_object has shape (3, 3); expected (4, 4)"
    assert message_of(np.full((4, 4), np.nan)) == "T_world_object holds NaN or infinity; expected finite numbers"
    assert message_of("here").startswith("T_world_object is not a matrix of numbers; expected 4 x 4 (")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"mass": 0.0}, "`mass` is 0.0; expected a finite number > 0"),
        ({"friction_hand": -0.1}, "`friction_hand` is -0.1; expected a finite number >= 0"),
        ({"friction_environment": float("nan")}, "`friction_environment` is nan; expected a finite number >= 0"),
        ({"motion_length": float("inf")}, "`motion_length` is inf; expected a finite number > 0"),
        ({"friction_hand": 1e300}, "`friction_hand` is 1e+300; expected at most 1e+06"),
        ({"object_mesh": trimesh.Trimesh()}, "the object mesh of the scene is empty; expected at least one triangle"),
    ],
)
def test_values_out_of_their_domain(scene, changes, expected):
    with pytest.raises(SceneError) as caught:
        dataclasses.replace(scene, **changes)
    assert str(caught.value) == expected


@pytest.mark.parametrize("decimals", [3, 4, 5])
def test_a_rounded_rotation_becomes_the_nearest_one(decimals):
    turn = trimesh.transformations.rotation_matrix(0.6, [1, 2, 3])
    found = rigid_transform(turn.round(decimals))
    np.testing.assert_allclose(found[:3, :3].T @ found[:3, :3], np.eye(3), atol=2e-5)
    np.testing.assert_allclose(found, turn.round(decimals), atol=10.0**-decimals)


def test_an_object_that_touches_nothing_is_refused(scene):
    def message_of(*position: float) -> str:
        pose = scene.T_world_object.copy()
        pose[:3, 3] = position
        with pytest.raises(SceneError) as caught:
            dataclasses.replace(scene, T_world_object=pose).validate()
        return str(caught.value)

    assert message_of(0, 0, 0.008) == (
        "the object touches nothing: the nearest surface is 3.0 mm below it; expected at most 1 mm; "
        "move the object by (0.0000, 0.0000, -0.0030) m in the world"
    )
    assert message_of(100, 0, 5.0) == (
        "the object touches nothing: the nearest surface is 99.6 m beside it; expected at most 1 mm; "
        "is the pose in millimetres? give its position in metres: it would touch there; if not, move the object "
        "by (-99.4250, 0.0000, -4.9950) m in the world"
    )


def test_surroundings_that_penetrate_the_object_are_refused(scene):
    scene.validate()
    sunk = scene.T_world_object.copy()
    sunk[2, 3] = 0.002  # 3 mm into the slab
    with pytest.raises(
        SceneError, match=r"^the environment already penetrates the object by 3\.0 mm near \("
    ) as caught:
        dataclasses.replace(scene, T_world_object=sunk).validate()
    assert "move the object away from that surface by (0.0000, 0.0000, 0.0030) m in the world" in str(caught.value)
    sunk[2, 3] = 0.0045  # half a millimetre, as a measured pose may be
    dataclasses.replace(scene, T_world_object=sunk).validate()
