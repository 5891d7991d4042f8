"""A scene rendered to depth comes back: object, support, surroundings; what was not seen stays solid."""

import numpy as np
import pytest
import trimesh

from dexnudge.errors import SceneError
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.perception.fusion import ASSUMED, SEEN, UNSEEN
from dexnudge.scenes.free_way import free_way
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.depth_camera import DepthCamera, DepthRenderer, looking_at

VOXEL = 0.006
SIZE = (0.15, 0.07, 0.02)
EYES = [(-0.35, 0.3, 0.4), (-0.4, -0.25, 0.4), (-0.5, 0.0, 0.3)]
CAMERA = DepthCamera(width=200, height=150, focal=190.0, noise=0.0, unit=0.0005)


def boxes(*bounds) -> trimesh.Trimesh:
    return trimesh.util.concatenate([trimesh.creation.box(bounds=np.array(each)) for each in bounds])


TABLE = ((-0.3, -0.4, -0.04), (0.3, 0.4, 0.0))
WALL = ((0.2, -0.4, -0.04), (0.24, 0.4, 0.3))
BLOCK = ((-0.18, -0.03, 0.0), (-0.14, 0.03, 0.03))  # 6.5 cm before the phone


def pose_of(x=0.0, y=0.0, z=0.01) -> np.ndarray:
    return trimesh.transformations.translation_matrix([x, y, z])


def views_of(surroundings, *, eyes=EYES, pose=None):
    thing = trimesh.creation.box(SIZE)
    scene = Scene(thing, surroundings, pose_of() if pose is None else pose, np.array([-1.0, 0.0, 0.0]))
    renderer, generator = DepthRenderer(scene, CAMERA), np.random.default_rng(0)
    return [renderer.view(looking_at(np.zeros(3), np.array(eye)), generator) for eye in eyes]


@pytest.fixture(scope="module")
def views():
    return views_of(boxes(TABLE, WALL))


@pytest.fixture(scope="module")
def with_mesh(views):
    return Scene.from_depth(
        views, object=trimesh.creation.box(SIZE), object_pose=pose_of(), motion=[-1, 0, 0], voxel=VOXEL
    )


def test_object_and_supports_are_those_that_were_rendered(with_mesh):
    np.testing.assert_allclose(with_mesh.T_world_object, pose_of(), atol=2e-3)
    [below] = [support for support in with_mesh.supports if support.side == "below"]
    np.testing.assert_allclose(below.normal, [0, 0, 1], atol=0.01)
    assert below.offset == pytest.approx(0, abs=1e-3)
    assert below.area > 0.9 * SIZE[0] * SIZE[1]
    assert [support.side for support in with_mesh.supports] == ["below"]


def test_the_surface_lies_where_table_and_wall_were_rendered(with_mesh):
    mesh, origin = with_mesh.environment_mesh, with_mesh.environment_mesh.metadata["origin"]
    assert origin.shape == (len(mesh.faces),)
    true = ExactDistance(boxes(TABLE, WALL))
    seen = mesh.triangles_center[origin == SEEN]
    assert len(seen) > 1000
    assert np.quantile(np.abs(true(seen).distance), 0.95) < 2e-3
    assumed = mesh.triangles_center[origin == ASSUMED]
    under = (np.abs(assumed[:, :2]) < np.array(SIZE[:2]) / 2 - 0.01).all(axis=1) & (np.abs(assumed[:, 2]) < 0.02)
    assert under.sum() > 100  # the table below the phone was not seen
    assert np.abs(assumed[under][:, 2]).max() < 2e-3
    assert any("assumed" in note and "solid" in note for note in with_mesh.notes)


def test_nothing_unseen_touches_the_object(with_mesh):
    mesh, origin = with_mesh.environment_mesh, with_mesh.environment_mesh.metadata["origin"]
    unseen = mesh.triangles[origin == UNSEEN].reshape(-1, 3)
    assert ExactDistance(with_mesh.object_in_world())(unseen).distance.min() > 1.5e-3


def test_behind_the_wall_is_solid_unless_unseen_is_free(views, with_mesh):
    inside = np.array([[0.28, 0.0, 0.15], [0.1, 0.0, -0.1]])  # behind the wall, below the table
    assert (ExactDistance(with_mesh.environment_mesh)(inside).distance < -0.02).all()
    free = Scene.from_depth(
        views, object=trimesh.creation.box(SIZE), object_pose=pose_of(), motion=[-1, 0, 0], voxel=VOXEL, unseen="free"
    )
    assert (ExactDistance(free.environment_mesh)(inside).distance > 0.02).all()


def test_a_point_cloud_with_its_view_points_gives_the_same_world(views, with_mesh, tmp_path):
    np.save(tmp_path / "cloud.npy", np.concatenate([view.points()[::3] for view in views]))
    scene = Scene.from_depth(
        tmp_path / "cloud.npy",
        view_points=EYES,
        object=trimesh.creation.box(SIZE),
        object_pose=pose_of(),
        motion=[-1, 0, 0],
        voxel=VOXEL,
    )
    np.testing.assert_allclose(scene.T_world_object, pose_of(), atol=2e-3)
    assert [support.side for support in scene.supports] == ["below"]
    mesh = scene.environment_mesh
    seen = mesh.triangles_center[mesh.metadata["origin"] == SEEN]
    assert np.quantile(np.abs(ExactDistance(boxes(TABLE, WALL))(seen).distance), 0.95) < 3e-3
    beside = np.array([[-0.12, 0.0, 0.02], [0.0, -0.08, 0.02], [-0.12, 0.0, -0.02]])
    for found in (scene, with_mesh):
        assert (ExactDistance(found.environment_mesh)(beside).distance > 0).tolist() == [True, True, False]


def test_from_its_masks_alone_it_is_the_same_box(views):
    scene = Scene.from_depth(views, motion=[-1, 0, 0], voxel=VOXEL)
    np.testing.assert_allclose(scene.object_mesh.extents, SIZE, atol=9e-3)  # pixels of 2.5 mm, two lost at each edge
    np.testing.assert_allclose(scene.object_in_world().bounds.mean(axis=0), [0, 0, 0.01], atol=5e-3)
    assert any("prism" in note for note in scene.notes)


def test_what_stands_in_the_way_blocks(with_mesh):
    views, box = views_of(boxes(TABLE, WALL, BLOCK)), trimesh.creation.box(SIZE)
    blocked = Scene.from_depth(views, object=box, object_pose=pose_of(), motion=[-1, 0, 0], voxel=VOXEL)
    way = free_way(blocked)
    shadow = 0.03 / 0.3 * 0.35  # [m] behind the block, which no view looks into, and which counts as solid
    assert 0.065 - shadow - 2 * VOXEL < way.length < 0.065 + VOXEL
    assert -0.14 - VOXEL < way.place[0] < -0.14 + shadow + 2 * VOXEL
    assert free_way(with_mesh).place is None


def refusal(views, **given) -> str:
    with pytest.raises(SceneError) as caught:
        Scene.from_depth(views, motion=[-1, 0, 0], voxel=VOXEL, **given)
    assert "expected" in str(caught.value)
    return str(caught.value)


def test_views_that_do_not_see_the_object_are_refused(views):
    box = trimesh.creation.box(SIZE)
    assert "is the pose in millimetres" in refusal(views, object=box, object_pose=pose_of(0, 0, 10.0))
    assert "in one frame" in refusal(views, object=box, object_pose=pose_of(3, 0, 0))
    assert "see through the object" in refusal(views, object=box, object_pose=pose_of(-0.1, 0, 0.15))
    assert "hidden" in refusal(views, object=box, object_pose=pose_of(0.35, 0, 0.1))


def test_arguments_that_do_not_go_together_are_refused(views):
    assert "without `object`" in refusal(views, object_pose=pose_of())
    assert "without `object_pose`" in refusal(views, object=trimesh.creation.box(SIZE))
    assert "`unseen` is 'air'" in refusal(views, unseen="air")


def test_what_was_seen_and_what_was_not_is_kept_in_the_folder(with_mesh, tmp_path):
    with_mesh.save(tmp_path)
    again = Scene.load(tmp_path).environment_mesh
    written = with_mesh.environment_mesh
    for kind in (SEEN, ASSUMED, UNSEEN):
        area = written.area_faces[written.metadata["origin"] == kind].sum()
        assert again.area_faces[again.metadata["origin"] == kind].sum() == pytest.approx(area, rel=1e-3)
    path = tmp_path / "scene.json"
    path.write_text(path.read_text().replace('"environment_faces_seen_assumed_unseen": [', '"x": [', 1))
    assert "origin" not in Scene.load(tmp_path).environment_mesh.metadata
