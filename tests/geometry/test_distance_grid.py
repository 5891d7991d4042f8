"""The voxel grid against the exact distance: near a surface it must be good to a quarter of a millimetre."""

from functools import cache

import numpy as np
import pytest
import trimesh
import warp as wp
from scipy.interpolate import RegularGridInterpolator

from dexnudge.energies.grid_kernel import (
    PackedGrids,
    grid_distance,
    least_distance,
    least_distance_anywhere,
    pack_grids,
)
from dexnudge.energies.kernel_inputs import OBJECT_CELL, OBJECT_PADDING
from dexnudge.geometry.distance_grid import DistanceGrid, distance_grid
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.objects.builtin import builtin_object

NEAR, WORST = 0.005, 0.00025  # [m] DESIGN: at most 0.25 mm off near a surface
DEEPEST = 0.001  # [m] the penetration that a configuration may have


@wp.kernel(enable_backward=False)
def look_up(grids: PackedGrids, index: int, points: wp.array(dtype=wp.vec3), found: wp.array(dtype=wp.vec4)):
    i = wp.tid()
    found[i] = grid_distance(grids.headers[index], grids.values, points[i])


def values_of(grids: list[DistanceGrid], points: np.ndarray, *, index: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(distance, gradient) as the fused kernel reads them."""
    found = wp.zeros(len(points), dtype=wp.vec4, device="cpu")
    queried = wp.array(points.astype(np.float32), dtype=wp.vec3, device="cpu")
    wp.launch(look_up, dim=len(points), inputs=[pack_grids(grids), index, queried, found], device="cpu")
    return found.numpy()[:, 0], found.numpy()[:, 1:]


def axes_of(grid: DistanceGrid) -> list[np.ndarray]:
    return [grid.origin[axis] + grid.cell * np.arange(grid.values.shape[axis]) for axis in range(3)]


@cache
def build(name: str) -> tuple[trimesh.Trimesh, ExactDistance, DistanceGrid]:
    """The grid as `scene_fields` builds it."""
    mesh = builtin_object(name)
    exact = ExactDistance(mesh)
    lower, upper = mesh.bounds
    return mesh, exact, distance_grid(exact, lower - OBJECT_PADDING, upper + OBJECT_PADDING, cell=OBJECT_CELL)


@cache
def near_points(name: str) -> tuple[np.ndarray, np.ndarray]:
    """(points within 5 mm of the surface, their exact distances): half of them inside."""
    mesh, exact, _ = build(name)
    generator = np.random.default_rng(0)
    on_surface, faces = trimesh.sample.sample_surface(mesh, 20_000, seed=generator)
    points = on_surface + generator.uniform(-NEAR, NEAR, (len(faces), 1)) * mesh.face_normals[faces]
    true = exact(points).distance
    near = np.abs(true) <= NEAR
    assert min((true[near] > 0).sum(), (true[near] <= 0).sum()) > 5_000
    return points[near], true[near]


@pytest.fixture(scope="module")
def phone():
    return build("phone")


def inside_points(grid: DistanceGrid, count: int) -> np.ndarray:
    low, high = (np.asarray([axis[end] for axis in axes_of(grid)]) for end in (0, -1))
    return np.random.default_rng(0).uniform(low + 1e-6, high - 1e-6, (count, 3))


OFF_CENTRE = pytest.mark.xfail(
    raises=AssertionError,
    reason="a bump or covers put the ridge of the depth between two planes of corners, in cells of 1 mm",
)


@pytest.mark.parametrize(
    "name", ["remote", "tablet", pytest.param("phone", marks=OFF_CENTRE), pytest.param("book", marks=OFF_CENTRE)]
)
def test_within_5_mm_of_the_surface_on_both_sides_it_is_within_a_quarter_of_a_millimetre(name):
    _, _, grid = build(name)
    points, true = near_points(name)
    error = np.abs(values_of([grid], points)[0] - true)
    assert np.quantile(error, 0.999) <= WORST


@pytest.mark.parametrize("name", ["phone", "remote", "tablet", "book"])
def test_as_deep_as_a_configuration_may_be_and_5_mm_outside_it_is_so_for_every_object(name):
    _, _, grid = build(name)
    points, true = near_points(name)
    shallow = true > -DEEPEST
    error = np.abs(values_of([grid], points[shallow])[0] - true[shallow])
    assert np.quantile(error, 0.999) <= WORST


def test_deep_inside_it_is_within_half_a_cell():
    _, _, grid = build("phone")
    points, true = near_points("phone")
    deep = true < -DEEPEST
    assert np.abs(values_of([grid], points[deep])[0] - true[deep]).max() <= grid.cell / 2


def test_corners_hold_the_exact_distance(phone):
    _, exact, grid = phone
    corners = np.stack(np.meshgrid(*axes_of(grid), indexing="ij"), axis=-1)
    some = tuple(np.random.default_rng(2).integers(grid.values.shape, size=(500, 3)).T)
    np.testing.assert_allclose(grid.values[some], exact(corners[some]).distance, atol=1e-6)


def boxes(*bounds: tuple[tuple[float, float, float], tuple[float, float, float]]) -> trimesh.Trimesh:
    return trimesh.util.concatenate([trimesh.creation.box(bounds=np.array(pair)) for pair in bounds])


def inside_out(bounds: tuple[tuple[float, float, float], tuple[float, float, float]]) -> trimesh.Trimesh:
    mesh = boxes(bounds)
    mesh.invert()
    return mesh


def with_hole() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    mesh.update_faces(mesh.triangles_center[:, 2] < 0.042)
    return mesh


def top() -> trimesh.Trimesh:
    mesh = trimesh.creation.box(bounds=[[-0.15, -0.1, -0.04], [0.2, 0.1, -0.03]]).subdivide_to_size(0.03)
    mesh.update_faces(mesh.face_normals[:, 2] > 0.5)
    return mesh


def torn(share: float) -> trimesh.Trimesh:
    """Boards without some of their triangles."""
    mesh = boxes(
        ((-0.05, -0.05, 0.0), (0.05, 0.05, 0.03)), ((-0.05, -0.02, 0.04), (0.05, 0.05, 0.06))
    ).subdivide_to_size(0.02)
    mesh.update_faces(np.random.default_rng(0).random(len(mesh.faces)) > share)
    return mesh


def turned(share: float) -> trimesh.Trimesh:
    """Boards some of whose triangles are the other way round."""
    mesh = torn(0.0)
    other = np.random.default_rng(0).random(len(mesh.faces)) < share
    return trimesh.Trimesh(mesh.vertices, np.where(other[:, None], mesh.faces[:, ::-1], mesh.faces), process=False)


def triangles_apart(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3), process=False)


BOARDS = {
    "two boards, one thinner than a cell": lambda: boxes(
        ((-0.05, -0.05, -0.03), (0.05, 0.05, -0.01)), ((-0.06, -0.04, 0.02), (0.05, 0.05, 0.0215))
    ),
    "overlapping boards around a cavity": lambda: boxes(
        ((-0.05, -0.05, -0.05), (0.05, 0.05, -0.03)),
        ((-0.05, -0.05, 0.03), (0.05, 0.05, 0.05)),
        ((-0.05, -0.05, -0.05), (-0.03, 0.05, 0.05)),
        ((0.03, -0.05, -0.05), (0.05, 0.05, 0.05)),
    ),
    "as large as the grid": lambda: boxes(((-0.2, -0.2, -0.2), (0.2, 0.2, 0.2))),
    "far away": lambda: boxes(((0.5, -0.2, -0.2), (0.6, 0.2, 0.2))),
    "sphere with a hole": with_hole,
    "table's top, and boards with holes everywhere": lambda: trimesh.util.concatenate([top(), torn(0.05)]),
    "triangles that share no corner": lambda: triangles_apart(with_hole()),
    "triangles that disagree about the outside": lambda: turned(0.02),
    "boards of which one is inside out": lambda: trimesh.util.concatenate(
        [boxes(((-0.05, -0.05, -0.03), (0.05, 0.05, -0.01))), inside_out(((-0.05, -0.05, 0.0), (0.05, 0.05, 0.03)))]
    ),
}


@pytest.mark.parametrize("name", BOARDS)
def test_sign_and_distance_are_those_asked_for_at_every_corner(name):
    exact = ExactDistance(BOARDS[name]())
    grid = distance_grid(exact, np.full(3, -0.08), np.full(3, 0.08), cell=0.004)
    corners = np.stack(np.meshgrid(*axes_of(grid), indexing="ij"), axis=-1).reshape(-1, 3)
    expected = exact(corners).distance.reshape(grid.values.shape)
    np.testing.assert_array_equal(grid.values, expected.astype(np.float32))


@pytest.mark.parametrize("name", BOARDS)
def test_only_distances_beyond_what_is_relevant_are_rounded_down(name):
    exact = ExactDistance(BOARDS[name]())
    whole = distance_grid(exact, np.full(3, -0.08), np.full(3, 0.08), cell=0.004).values
    found = distance_grid(exact, np.full(3, -0.08), np.full(3, 0.08), cell=0.004, relevant=0.02).values
    rounded = found != whole
    assert (whole[rounded] > 0.02).all()
    assert (found[rounded] > 0.02).all()
    assert (found[rounded] <= whole[rounded] + 1e-8).all()  # two roundings of float32 at 0.1 m
    assert (found[rounded] >= whole[rounded] - 2 * 0.004 * np.sqrt(3) - 1e-8).all()


def test_the_box_is_covered_to_its_end(phone):
    mesh, _, grid = phone
    reached = [axis[-1] for axis in axes_of(grid)]
    assert (np.asarray(reached) >= mesh.bounds[1] + OBJECT_PADDING - 1e-9).all()
    np.testing.assert_allclose(grid.origin, mesh.bounds[0] - OBJECT_PADDING)


def test_lookup_equals_scipys_interpolation(phone):
    _, _, grid = phone
    points = inside_points(grid, 5000)
    expected = RegularGridInterpolator(axes_of(grid), grid.values.astype(np.float64))(points.astype(np.float32))
    np.testing.assert_allclose(values_of([grid], points)[0], expected, atol=2e-6)


def test_gradient_equals_finite_differences(phone):
    _, _, grid = phone
    cells = np.random.default_rng(3).integers(np.asarray(grid.values.shape) - 1, size=(500, 3))
    points = grid.origin + grid.cell * (cells + np.random.default_rng(4).uniform(0.2, 0.8, (500, 3)))
    interpolate, step = RegularGridInterpolator(axes_of(grid), grid.values.astype(np.float64)), 0.1 * grid.cell
    slopes = [
        (interpolate(points + step * axis) - interpolate(points - step * axis)) / (2 * step) for axis in np.eye(3)
    ]
    np.testing.assert_allclose(values_of([grid], points)[1], np.stack(slopes, axis=1), atol=2e-3)


def test_outside_its_box_it_is_the_value_at_the_box_plus_the_way_there(phone):
    _, exact, grid = phone
    low, high = (np.asarray([axis[end] for axis in axes_of(grid)]) for end in (0, -1))
    points = np.random.default_rng(5).uniform(low - 0.3, high + 0.3, (2000, 3))
    points = points[((points < low - 1e-3) | (points > high + 1e-3)).any(axis=1)]
    nearest = np.clip(points, low, high)
    gap = np.linalg.norm(points - nearest, axis=1)
    interpolate = RegularGridInterpolator(axes_of(grid), grid.values.astype(np.float64))
    distance, gradient = values_of([grid], points)
    np.testing.assert_allclose(distance, interpolate(nearest) + gap, atol=1e-5)
    np.testing.assert_allclose(gradient, (points - nearest) / gap[:, None], atol=1e-3)
    assert (distance >= exact(points).distance - WORST).all(), "the way over the box is a detour"


def test_the_second_of_two_packed_grids_is_read(phone):
    _, _, grid = phone
    other = DistanceGrid(np.full((2, 3, 4), 7.0, dtype=np.float32), np.zeros(3), 0.01)
    points = np.asarray([[0.005, 0.011, 0.02]])
    assert values_of([grid, other], points, index=1)[0] == pytest.approx(7.0)
    assert values_of([other, grid], points, index=1)[0] == pytest.approx(values_of([grid], points)[0])


@wp.kernel(enable_backward=False)
def look_around(
    grids: PackedGrids,
    centres: wp.array(dtype=wp.vec3),
    radii: wp.array(dtype=float),
    in_box: wp.array(dtype=float),
    anywhere: wp.array(dtype=float),
):
    i = wp.tid()
    in_box[i] = least_distance(grids.headers[0], grids.values, centres[i], radii[i])
    anywhere[i] = least_distance_anywhere(grids.headers[0], grids.values, centres[i], radii[i])


def test_no_point_of_a_sphere_is_closer_than_the_sphere_s_least_distance(phone):
    _, _, grid = phone
    generator = np.random.default_rng(6)
    low, high = (np.asarray([axis[end] for axis in axes_of(grid)]) for end in (0, -1))
    spheres, probes = 400, 2000
    centres = generator.uniform(low - 0.03, high + 0.03, (spheres, 3)).astype(np.float32)
    radii = generator.uniform(0.001, 0.03, spheres).astype(np.float32)
    in_box, anywhere = (wp.zeros(spheres, dtype=float, device="cpu") for _ in range(2))
    inputs = [pack_grids([grid]), wp.array(centres, dtype=wp.vec3, device="cpu"), wp.array(radii, device="cpu")]
    wp.launch(look_around, dim=spheres, inputs=[*inputs, in_box, anywhere], device="cpu")
    rays = generator.normal(size=(spheres, probes, 3))
    rays *= generator.uniform(size=(spheres, probes, 1)) ** (1 / 3) / np.linalg.norm(rays, axis=2, keepdims=True)
    points = centres[:, None] + radii[:, None, None] * rays
    distance = values_of([grid], points.reshape(-1, 3))[0].reshape(spheres, probes)
    inside = ((points >= low) & (points <= high)).all(axis=2)
    lowest_inside = np.where(inside, distance, np.inf).min(axis=1)
    assert (anywhere.numpy() <= distance.min(axis=1) + 1e-6).all()
    assert (in_box.numpy() <= lowest_inside + 1e-6)[inside.any(axis=1)].all()
    slack = 2 * np.sqrt(3) * grid.cell + 0.4 * radii  # the nearest point of a smooth place, and the bound's own margin
    assert np.median(distance.min(axis=1) - anywhere.numpy() - slack) < 0, "a bound that rules nothing out is no use"
