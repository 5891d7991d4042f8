"""Coarse far surroundings: near ones keep every bit, and the surface winds around near points as before."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from dexnudge.geometry import coarsening
from dexnudge.geometry.coarsening import coarsened_faces, coarsened_far
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.mesh_repair import solid_angles
from dexnudge.perception.fusion import isosurface

LOW, HIGH = np.array([-0.1, -0.05, 0.0]), np.array([0.1, 0.05, 0.02])
REACH = 0.2


@pytest.fixture(scope="module")
def room():
    """A closed slab with an uneven surface of fine triangles, and a wall of two large ones beside the object."""
    slab = trimesh.creation.box((4.0, 4.0, 0.5)).subdivide_to_size(0.12)
    slab.apply_translation((0, 0, -0.25))
    slab.vertices += 0.004 * np.sin(40 * slab.vertices[:, [1, 2, 0]])
    wall = trimesh.creation.box((0.02, 3.0, 2.0))
    wall.apply_translation((-0.3, 0.2, 1.0))
    return trimesh.util.concatenate([slab, wall])


@pytest.fixture(scope="module")
def coarse(room):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(coarsening, "LARGE", 1000)
        return coarsened_far(room, LOW, HIGH, reach=REACH)


def test_few_triangles_stay_as_they_are(room):
    assert coarsened_far(room, LOW, HIGH, reach=REACH) is room


def test_there_are_fewer_and_a_note_says_so(room, coarse):
    assert len(coarse.faces) < len(room.faces) / 2
    (note,) = coarse.metadata["notes"]
    assert note == (
        f"{len(room.faces):,} triangles; those more than 200 mm from the object and its way were joined "
        f"to coarser ones, {len(coarse.faces):,} are left"
    )


def test_faces_within_reach_keep_every_bit(room, coarse):
    def near(mesh):
        low, high = mesh.triangles.min(axis=1), mesh.triangles.max(axis=1)
        return mesh.triangles[((low <= HIGH + REACH) & (high >= LOW - REACH)).all(axis=1)]

    np.testing.assert_array_equal(near(coarse), near(room))


def test_the_surface_winds_around_near_points_as_before(room, coarse):
    points = np.random.default_rng(0).uniform(LOW - REACH, HIGH + REACH, (200, 3))
    winding = [
        [solid_angles(np.asarray(mesh.triangles) - point).sum() / (4 * np.pi) for point in points]
        for mesh in (room, coarse)
    ]
    assert {-1, 0, 1} >= set(np.round(winding[0]).astype(int)) > {0}
    np.testing.assert_allclose(winding[1], winding[0], atol=1e-6)
    distance = [ExactDistance(mesh)(points).distance for mesh in (room, coarse)]
    close = np.abs(distance[0]) < 0.15  # all whose nearest surface is surely within reach
    np.testing.assert_allclose(distance[1][close], distance[0][close], atol=1e-6)
    assert (distance[0] < 0).any()
    assert (distance[0] > 0).any()


def test_an_open_border_stays_an_open_border(room):
    top = room.copy()
    top.update_faces(top.face_normals[:, 2] > 0.5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(coarsening, "LARGE", 500)
        found = coarsened_far(top, LOW, HIGH, reach=REACH)
    assert len(found.faces) < 0.7 * len(top.faces)
    for height in (-0.05, 0.05):
        point = np.array([0.05, 0.02, height])
        before, after = (solid_angles(np.asarray(mesh.triangles) - point).sum() for mesh in (top, found))
        assert after == pytest.approx(before, abs=0.02)


@pytest.fixture(scope="module")
def fused():
    """A voxel surface as of unseen space: a rough solid with a hollow and crumbs, many of which nearly touch."""
    rng = np.random.default_rng(0)
    solid = np.full((40, 40, 24), 1.0)
    solid[2:-2, 2:-2, 2:16] = -1.0
    solid[2:-2, 2:-2, 12:18] = np.where(rng.random((36, 36, 6)) < 0.5, -1.0, 1.0)
    solid[12:20, 12:20, 5:9] = 1.0
    vertices, faces, _ = isosurface(solid)
    return trimesh.Trimesh(0.004 * vertices, faces, process=False)


@pytest.fixture(scope="module")
def thinned(fused):
    known = fused.triangles_center[:, 0] < 0.04
    near = fused.bounds[0], fused.bounds[0] + 0.05
    return known, *coarsened_faces(fused, ~known, *near, reach=0.01, cell=0.016)


def test_a_rough_closed_surface_stays_closed_with_a_fraction_of_its_faces(fused, thinned):
    known, coarse, kept = thinned
    assert fused.is_watertight
    assert coarse.is_watertight
    assert coarse.is_winding_consistent
    assert len(coarse.faces) < 0.5 * len(fused.faces)
    assert (~known[kept]).sum() < 0.2 * (~known).sum()


def test_what_is_known_and_what_is_near_keeps_its_place(fused, thinned):
    known, coarse, kept = thinned
    near = (fused.triangles.min(axis=1) <= fused.bounds[0] + 0.06).all(axis=1)
    for fixed in (known, near):
        before, after = (mesh.triangles_center[which] for mesh, which in ((fused, fixed), (coarse, fixed[kept])))
        assert cKDTree(after).query(before)[0].max() < 1e-9


def test_deep_solid_stays_solid_and_wide_room_stays_free(fused, thinned):
    low, high = fused.bounds
    points = np.random.default_rng(1).uniform(low - 0.02, high + 0.02, (3000, 3))
    before, after = (ExactDistance(mesh)(points).distance for mesh in (fused, thinned[1]))
    clear = np.abs(before) > 0.008  # two voxels
    assert clear.sum() > 500
    assert ((before > 0) == (after > 0))[clear].all()
