"""Point clouds from files and arrays, and the surface that they give with their view points."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dexnudge.errors import SceneError
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.perception.fusion import SEEN, fuse
from dexnudge.perception.point_cloud import cloud_views, load_point_cloud
from dexnudge.perception.views import load_views

LOW, HIGH = np.array([-0.16, -0.16, -0.05]), np.array([0.16, 0.16, 0.16])
TABLE, BOX = ((-1, -1, -0.2), (1, 1, 0.001)), ((-0.05, -0.04, 0.0), (0.06, 0.05, 0.081))
EYES = np.array([(0.5 * np.cos(turn), 0.5 * np.sin(turn), 0.4) for turn in np.arange(3) * 2 * np.pi / 3])
VOXEL = 0.004
POINTS = np.random.default_rng(0).normal(size=(12, 3))


@pytest.fixture(scope="module")
def cloud(camera) -> np.ndarray:
    points = np.concatenate([camera((TABLE, BOX), eye, (0, 0, 0.03), focal=200.0).points() for eye in EYES])
    return points[np.abs(points).max(axis=1) < 0.4]


def pcd(path: Path, points, kind: str = "binary", height: int = 1, view_point=(0, 0, 0)) -> Path:
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS rgb z x y _\nSIZE 4 4 4 8 1\nTYPE U F F F U\nCOUNT 1 1 1 1 3\n"
        f"WIDTH {len(points) // height}\nHEIGHT {height}\nVIEWPOINT {' '.join(map(str, view_point))} 1 0 0 0\n"
        f"POINTS {len(points)}\nDATA {kind}\n"
    )
    if kind == "ascii":
        body = "".join(f"7 {z} {x} {y} 1 2 3\n" for x, y, z in points).encode()
    else:
        rows = np.zeros(len(points), dtype=[("rgb", "<u4"), ("z", "<f4"), ("x", "<f4"), ("y", "<f8"), ("_", "u1", 3)])
        rows["x"], rows["y"], rows["z"] = np.asarray(points).T
        body = rows.tobytes()
    path.write_bytes(header.encode() + body)
    return path


def test_a_cloud_with_its_view_points_gives_the_surface_that_was_seen(cloud):
    found = fuse(cloud_views(cloud, EYES), LOW, HIGH, voxel=VOXEL)
    points = found.mesh.vertices[np.unique(found.mesh.faces[found.origin == SEEN])]
    beyond = [np.maximum(np.subtract(low, points), np.subtract(points, high)) for low, high in (TABLE, BOX)]
    error = np.abs(
        np.min([np.linalg.norm(np.maximum(each, 0), axis=1) + np.minimum(each.max(axis=1), 0) for each in beyond], 0)
    )
    assert len(points) > 8_000
    assert np.quantile(error, 0.9) < 0.3 * VOXEL
    assert error.max() < 1.5 * VOXEL
    places = np.array([[0, 0, 0.04], [0.12, 0, -0.02], [0.12, 0, 0.03], [0, 0, 0.12]])
    assert (ExactDistance(found.mesh)(places).distance < 0).tolist() == [True, True, False, False]


def test_what_no_view_point_saw_stays_unseen(cloud):
    one, all_of_them = (fuse(cloud_views(cloud, eyes), LOW, HIGH, voxel=VOXEL) for eyes in (EYES[:1], EYES))
    assert one.unseen > 1.3 * all_of_them.unseen
    behind = np.array([[-0.07, 0.0, 0.02]])
    assert ExactDistance(one.mesh)(behind).distance[0] < 0
    assert ExactDistance(all_of_them.mesh)(behind).distance[0] > 0


def test_a_sensor_amid_its_points_looks_to_all_sides():
    points = trimesh.creation.box((0.8, 1.0, 1.2)).sample(60_000, seed=1)
    views = cloud_views(points, np.zeros((1, 3)))
    assert len(views) == 6
    found = fuse(views, np.full(3, -0.7), np.full(3, 0.7), voxel=0.02)
    inside = found.mesh.vertices[np.unique(found.mesh.faces[found.origin == SEEN])]
    assert np.abs((np.abs(inside) / [0.4, 0.5, 0.6]).max(axis=1) - 1).max() < 0.05
    room = np.array([[0.35, 0.45, 0.55], [-0.35, -0.45, -0.55], [0, 0, 0]])
    assert (ExactDistance(found.mesh)(room).distance > 0).all()


def test_files_hold_the_same_points(tmp_path):
    np.save(tmp_path / "plain.npy", POINTS)
    np.save(tmp_path / "normals.npy", np.hstack([POINTS, POINTS]))
    trimesh.PointCloud(POINTS).export(tmp_path / "cloud.ply")
    pcd(tmp_path / "binary.pcd", POINTS)
    pcd(tmp_path / "ascii.pcd", POINTS, "ascii")
    for path in tmp_path.iterdir():
        np.testing.assert_allclose(load_point_cloud(path).points, POINTS, atol=1e-6)


def test_pixels_of_an_organised_cloud_may_lack_depth_and_points_may_not(tmp_path):
    holed = POINTS.copy()
    holed[[3, 5], 1] = np.nan
    kept = np.delete(POINTS, [3, 5], axis=0)
    for kind in ("ascii", "binary"):
        np.testing.assert_allclose(load_point_cloud(pcd(tmp_path / "a.pcd", holed, kind, 3)).points, kept, atol=1e-6)
        with pytest.raises(
            SceneError, match=r"a\.pcd: 2 of 12 points hold NaN or infinity, the first is number 3; expected"
        ):
            load_point_cloud(pcd(tmp_path / "a.pcd", holed, kind))
    np.save(tmp_path / "grid.npy", holed.reshape(3, 4, 3))
    np.testing.assert_allclose(load_point_cloud(tmp_path / "grid.npy").points, kept)
    with pytest.raises(SceneError, match="the point cloud: 2 of 12 points hold NaN"):
        cloud_views(holed, EYES)


def test_view_points_come_from_the_call_a_json_file_or_the_pcd(tmp_path, cloud):
    few = cloud[::5]
    (tmp_path / "eyes.json").write_text(json.dumps(EYES.tolist()))
    from_file, given = (cloud_views(few, eyes) for eyes in (tmp_path / "eyes.json", EYES))
    assert [view.T_world_camera.tolist() for view in from_file] == [view.T_world_camera.tolist() for view in given]
    stated = cloud_views(pcd(tmp_path / "a.pcd", few, view_point=EYES[0]))
    np.testing.assert_allclose([view.T_world_camera[:3, 3] for view in stated], np.tile(EYES[0], (len(stated), 1)))
    with pytest.raises(SceneError, match=r"b\.pcd: `view_points` is missing; expected \(k, 3\)"):
        cloud_views(pcd(tmp_path / "b.pcd", few))


def test_a_cloud_is_loaded_where_views_are(tmp_path, cloud):
    np.save(tmp_path / "cloud.npy", cloud[::5])
    loaded, made = load_views(tmp_path / "cloud.npy", view_points=EYES), cloud_views(cloud[::5], EYES)
    assert [view.depth.tolist() for view in loaded] == [view.depth.tolist() for view in made]
    with pytest.raises(SceneError, match=r"`masks` is .box_{}.png., but .* is a point cloud"):
        load_views(tmp_path / "cloud.npy", view_points=EYES, masks="box_{}.png")
    with pytest.raises(SceneError, match="`view_points` is given without a point cloud"):
        load_views(made, view_points=EYES)


@pytest.mark.parametrize(
    ("view_points", "text"),
    [
        ([[0, 0]], "`view_points`: has shape (1, 2); expected (k, 3)"),
        (np.zeros((65, 3)), "expected (k, 3) with k from 1 to 64"),
        ([["a", 0, 0]], "`view_points`: is [['a', 0, 0]]; expected a list of x, y, z [m]"),
        ([["1", "0", "0"]], "expected a list of x, y, z [m]"),
        ([[10**400, 0, 0]], "expected a list of x, y, z [m]"),
        ([[0, 0, 0], [1]], "expected a list of x, y, z [m]"),
        ([[0, 0, np.inf]], "holds NaN or infinity"),
        ([[0, 0, 400.0]], "m from view point 0 in the median; expected 0.02 to 20 m"),
    ],
)
def test_view_points_that_are_none(cloud, view_points, text):
    with pytest.raises(SceneError) as caught:
        cloud_views(cloud[::50], view_points)
    assert text in str(caught.value)


def test_clouds_that_are_none(tmp_path):
    def message(name: str, content=b"") -> str:
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SceneError) as caught:
            cloud_views(tmp_path / name, EYES)
        return str(caught.value).removeprefix(f"{tmp_path / name}: ")

    whole = pcd(tmp_path / "whole.pcd", POINTS).read_bytes()
    trimesh.creation.box().export(tmp_path / "box.ply")
    np.save(tmp_path / "flat.npy", POINTS[:, :2])
    np.save(tmp_path / "objects.npy", np.array([{}, 1], dtype=object), allow_pickle=True)
    assert message("a.xyz").startswith("unknown format '.xyz' of a point cloud; expected .ply, .pcd, .npy")
    assert message("a.npy").startswith("cannot be read as npy (EOFError); the file is truncated")
    assert message("b.npy", (tmp_path / "objects.npy").read_bytes()).startswith("cannot be read as npy (ValueError)")
    assert message("c.npy", (tmp_path / "flat.npy").read_bytes()).startswith("has shape (12, 2); expected (n, 3)")
    huge = (tmp_path / "flat.npy").read_bytes().replace(b"(12, 2), }      ", b"(9999999, 3), }").ljust(200)
    assert message("d.npy", huge).startswith("cannot be read as npy (ValueError)")
    assert message("e.npy", huge.replace(b"3), }", b"3), (")).startswith("cannot be read as npy (TokenError)")
    assert message("a.ply", (tmp_path / "box.ply").read_bytes()).startswith("has faces; expected a point cloud")
    assert message("b.ply", b"ply\nformat ascii 1.0\n").startswith("cannot be read as ply")
    assert message("a.pcd").startswith("cannot be read as pcd (no FIELDS in the header)")
    assert message("b.pcd", whole[:-5]).startswith("cannot be read as pcd (ValueError); the file is truncated")
    assert message("c.pcd", whole.replace(b" x y", b" u v")).startswith(
        "cannot be read as pcd (no x, y, z among its FIELDS"
    )
    assert message("d.pcd", whole.replace(b"DATA binary", b"DATA binary_compressed")).startswith(
        "its DATA is binary_compressed; expected ascii or binary; write it again with pcl_convert_pcd_ascii_binary"
    )
    assert message("e.pcd", whole.replace(b"WIDTH 12", b"WIDTH 99999999999")).startswith(
        "a header of 99,999,999,999 points"
    )
    few = pcd(tmp_path / "f.pcd", POINTS, "ascii").read_bytes()
    assert message("f.pcd", few[: few.rstrip().rfind(b"\n") + 1]).startswith("12 points announced, 11 read")
    with pytest.raises(SceneError, match="the point cloud: holds 3 points; expected a surface"):
        cloud_views(POINTS[:3], EYES)
    with pytest.raises(SceneError, match=r"a point is .* m away; expected metres; is it in millimetres"):
        cloud_views(1e4 * POINTS, EYES)
