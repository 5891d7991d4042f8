from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_lattice import surface_lattice
from dexnudge.mechanics.contacts import HandContacts, contacts_of_hands
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts, support_mask


def plate_contacts(points: np.ndarray, link: np.ndarray, distance: np.ndarray, normals: np.ndarray) -> HandContacts:
    """Contacts of hand points above the plane z = 0."""
    closest = points * [1, 1, 0]
    up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return contacts_of_hands(
        np.zeros_like(link), normals, link, num_hands=1, distance=distance, closest=closest, object_normals=up
    )[0]


def test_the_closest_point_comes_first_and_the_others_spread() -> None:
    grid = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2) * 1e-3
    distance = np.full(25, 1e-3)
    distance[12] = 0.5e-3  # the middle
    points = np.column_stack([grid, distance])
    found = plate_contacts(points, np.zeros(25, dtype=int), distance, np.tile([0.0, 0.0, -1.0], (25, 1)))
    np.testing.assert_allclose(found.points[0], [2e-3, 2e-3, 0])
    corners = {tuple(np.round(point[:2] * 1e3).astype(int)) for point in found.points[1:]}
    assert len(corners) == 3
    assert corners < {(0, 0), (0, 4), (4, 0), (4, 4)}


def test_far_and_averted_points_are_no_contacts() -> None:
    points = np.array([[0, 0, 0.0021], [0.01, 0, 0.0019], [0.02, 0, -0.0005], [0.03, 0, 0.001]])
    normals = np.array([[0, 0, -1.0], [0, 0, -1.0], [0.8, 0, -0.6], [0, 0, 1.0]])
    found = plate_contacts(points, np.array([0, 1, 2, 3]), points[:, 2], normals)
    assert found.link.tolist() == [1, 2]


def test_points_that_touch_the_same_place_are_one() -> None:
    points = np.zeros((6, 3))
    found = plate_contacts(points, np.array([3] * 6), np.arange(6) * 1e-4, np.tile([0.0, 0.0, -1.0], (6, 1)))
    assert len(found.points) == 1


@given(st.integers(0, 2**32 - 1))
def test_the_order_of_points_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.01, 0.01, (60, 3)) * [1, 1, 0.25]
    link, normals = rng.integers(0, 3, 60), rng.normal(size=(60, 3))
    order = rng.permutation(60)
    one = plate_contacts(points, link, points[:, 2], normals)
    other = plate_contacts(points[order], link[order], points[order, 2], normals[order])
    np.testing.assert_array_equal(one.points, other.points)
    np.testing.assert_array_equal(one.link, other.link)
    assert (np.unique(one.link, return_counts=True)[1] <= 4).all()


def scene(environment: trimesh.Trimesh, *, lift: float = 0.0, x: float = 0.0) -> Scene:
    """A block of 160 x 80 x 20 mm whose underside is at z = lift."""
    pose = np.eye(4)
    pose[:3, 3] = [x, 0.0, 0.01 + lift]
    return Scene(trimesh.creation.box((0.16, 0.08, 0.02)), environment, pose, np.array([1.0, 0.0, 0.0]))


def slab(low: list[float], high: list[float]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=np.array([low, high]))


FLOOR = slab([-0.5, -0.5, -0.02], [0.5, 0.5, 0.0])
CORNERS = [[-0.08, -0.04, 0.0], [-0.08, 0.04, 0.0], [0.08, -0.04, 0.0], [0.08, 0.04, 0.0]]


@pytest.mark.parametrize("lift", [-0.0009, 0.0, 0.0009])
def test_a_block_rests_on_its_four_corners(lift: float) -> None:
    found = support_contacts(scene(FLOOR, lift=lift))
    np.testing.assert_allclose(sorted(found.points.tolist()), CORNERS, atol=1e-6)
    np.testing.assert_allclose(found.normals, [[0, 0, 1]] * 4, atol=1e-6)


def test_a_block_that_turns_rests_on_nothing_beside_it() -> None:
    """The table's own points lie 2 mm apart, some of them less than 1 mm off the block."""
    for x in np.arange(5) * 0.0004:
        turning = replace(scene(FLOOR, x=x), turn=Turn(1.0, np.array([0.0, 0.0, 1.0]), np.zeros(3)))
        found = support_contacts(turning).points
        np.testing.assert_allclose(sorted((found - [x, 0, 0]).round(6).tolist()), CORNERS, atol=1e-6)


def test_a_block_in_the_air_rests_on_nothing() -> None:
    assert len(support_contacts(scene(FLOOR, lift=0.0011)).points) == 0


def test_a_block_over_the_edge_rests_on_what_is_below_it() -> None:
    table = slab([-0.5, -0.5, -0.02], [0.05, 0.5, 0.0])
    found = support_contacts(scene(table)).points
    assert found[:, 0].max() == pytest.approx(0.05, abs=2e-3)
    np.testing.assert_allclose(found[:, 2], 0, atol=1e-6)


def test_a_wall_beside_the_block_touches_its_flank_and_not_its_underside() -> None:
    wall = slab([-0.5, 0.0405, -0.02], [0.5, 0.06, 0.1])
    found = support_contacts(scene(trimesh.util.concatenate([FLOOR, wall])))
    on_wall = found.normals[:, 1] < -0.5
    np.testing.assert_allclose(sorted(found.points[~on_wall].tolist()), CORNERS, atol=1e-6)
    np.testing.assert_allclose(found.points[on_wall, 1], 0.0405, atol=1e-6)
    assert np.ptp(found.points[on_wall, 0]) == pytest.approx(0.16, abs=1e-6)
    assert found.points[on_wall, 2].max() == pytest.approx(0.02, abs=1e-6)


def test_a_ceiling_presses_down() -> None:
    ceiling = slab([-0.5, -0.5, 0.0205], [0.5, 0.5, 0.04])
    found = support_contacts(scene(trimesh.util.concatenate([FLOOR, ceiling])))
    above = found.normals[:, 2] < 0
    assert above.sum() == 4
    np.testing.assert_allclose(found.points[above, 2], 0.0205, atol=1e-6)


def test_supports_are_found_once_for_a_scene_and_anew_for_another() -> None:
    one = scene(FLOOR)
    assert support_contacts(one) is support_contacts(one)
    assert len(support_contacts(replace(one, T_world_object=scene(FLOOR, lift=0.01).T_world_object)).points) == 0


@pytest.mark.parametrize("subdivide", [0, 3])
def test_triangles_far_from_the_surroundings_are_left_out_without_a_difference(subdivide: int) -> None:
    wall = slab([-0.5, 0.0405, -0.02], [0.5, 0.06, 0.1])
    at_a_wall = scene(trimesh.util.concatenate([FLOOR, wall]), lift=0.0005)
    mesh = at_a_wall.object_mesh.copy()
    for _ in range(subdivide):
        mesh = mesh.subdivide()
    found = support_contacts(replace(at_a_wall, object_mesh=mesh))
    # Every point of every triangle looked up, with the sign, by the reference.
    moved = replace(at_a_wall, object_mesh=mesh).object_in_world()
    points, face = surface_lattice(np.asarray(moved.triangles, dtype=np.float64), spacing=2e-3)
    hit = ExactDistance(at_a_wall.environment_mesh)(points)
    resting = support_mask(moved.face_normals[face], distance=hit.distance, environment_normals=hit.normal)
    places = hit.closest[resting]
    for normal in ([0.0, 0.0, 1.0], [0.0, -1.0, 0.0]):
        mine = found.points[found.normals @ normal > 0.9]
        all_of_plane = places[hit.normal[resting] @ normal > 0.9]
        np.testing.assert_allclose(mine.min(axis=0), all_of_plane.min(axis=0), atol=1e-6)
        np.testing.assert_allclose(mine.max(axis=0), all_of_plane.max(axis=0), atol=1e-6)
