"""Depth views from files and arrays; every bad input is one clear error that says file and view."""

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from dexnudge.errors import SceneError
from dexnudge.perception import views
from dexnudge.perception.views import DepthView, load_views

WIDTH, HEIGHT = 40, 30
CAMERA = {"fx": 50.0, "fy": 52.0, "cx": 19.0, "cy": 14.5}
POSE = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], [0.3, 0, 1])


def entry(**changes) -> dict:
    plain = {"depth": "depth.png", "depth_unit": 0.001, "width": WIDTH, "height": HEIGHT, **CAMERA}
    return {**plain, "T_world_camera": POSE.tolist(), **changes}


@pytest.fixture
def folder(tmp_path) -> Path:
    depth = np.random.default_rng(0).integers(400, 600, (HEIGHT, WIDTH)).astype(np.uint16)
    depth[:5] = 0
    Image.fromarray(depth).save(tmp_path / "depth.png")
    mask = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    mask[10:20, 15:25] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    Image.fromarray(0 * mask).save(tmp_path / "empty.png")
    return tmp_path


def written(folder: Path, *entries) -> Path:
    (folder / "cameras.json").write_text(json.dumps(list(entries)))
    return folder


def refusal(folder: Path, **changes) -> str:
    with pytest.raises(SceneError) as caught:
        load_views(written(folder, entry(), entry(**changes)))
    text = str(caught.value)
    assert text.startswith(f"{folder / 'cameras.json'}: view 1"), text
    assert "expected" in text or "truncated" in text, text
    return text


def test_a_folder_its_file_and_the_views_give_the_same(folder):
    [view] = load_views(written(folder, entry(mask="mask.png")))
    [again] = load_views(str(folder / "cameras.json"))
    np.testing.assert_array_equal(view.depth, again.depth)
    assert load_views([view]) == [view]
    assert view.depth[10, 10] == pytest.approx(np.array(Image.open(folder / "depth.png"))[10, 10] / 1000)
    assert view.mask.sum() == 100
    assert not view.measured[:5].any()
    np.testing.assert_allclose(view.T_world_camera, POSE)


def test_points_and_projection_are_inverse_and_the_axis_points_forward(folder):
    [view] = load_views(written(folder, entry(mask="mask.png")))
    points = view.points()
    rows, columns = np.nonzero(view.measured)
    found = view.project(points)
    np.testing.assert_allclose(found, np.stack([columns, rows, view.depth[rows, columns]], axis=1), atol=1e-6)
    assert view.sees(points).all()
    assert len(view.points(view.mask)) == 100
    axis = POSE[:3, 3] + np.array([[1.0], [-1.0]]) * POSE[:3, 2]
    assert view.sees(axis).tolist() == [True, False]


def test_a_pixel_one_column_to_the_right_lies_along_the_cameras_x(folder):
    depth = np.full((HEIGHT, WIDTH), 0.5)
    points = DepthView(depth, **CAMERA, T_world_camera=POSE).points().reshape(HEIGHT, WIDTH, 3)
    np.testing.assert_allclose(points[3, 8] - points[3, 7], 0.5 / 50 * POSE[:3, 0], atol=1e-9)
    np.testing.assert_allclose(points[4, 7] - points[3, 7], 0.5 / 52 * POSE[:3, 1], atol=1e-9)


def test_what_is_not_finite_is_not_measured():
    depth = np.full((HEIGHT, WIDTH), 0.5)
    depth[0] = np.nan
    depth[1] = np.inf
    view = DepthView(depth, **CAMERA, T_world_camera=np.eye(4))
    assert view.measured.sum() == (HEIGHT - 2) * WIDTH


def test_the_masks_of_one_of_several_objects(folder):
    Image.open(folder / "mask.png").save(folder / "box_002.png")
    (folder / "box_000.png").write_bytes((folder / "empty.png").read_bytes())
    found = load_views(written(folder, entry(), entry(), entry()), masks="box_{:03}.png")
    assert [None if view.mask is None else int(view.mask.sum()) for view in found] == [0, None, 100]
    for masks, text in (
        ("tin_{}.png", f"{folder / 'tin_{}.png'}: no view's mask has a pixel; expected the object in one at least"),
        ("tin.png", "`masks` is 'tin.png'; expected a name with {} for the number of the view: box_{}.png"),
        ("{0.real}_{}{}", "`masks` is '{0.real}_{}{}'; expected a name with {} for the number of the view: box_{}.png"),
    ):
        with pytest.raises(SceneError) as caught:
            load_views(folder, masks=masks)
        assert str(caught.value) == text


@pytest.mark.parametrize("mode", ["1", "L", "LA", "RGB", "RGBA", "P", "I;16"])
def test_masks_of_any_kind_of_png(folder, mode):
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    mask[3:9, 4:30] = True
    image = Image.fromarray(mask.astype(np.uint16)) if mode == "I;16" else Image.fromarray(mask).convert(mode)
    image.save(folder / "mask.png")
    [view] = load_views(written(folder, entry(mask="mask.png")))
    np.testing.assert_array_equal(view.mask, mask)


@pytest.mark.parametrize("key", ["depth", "depth_unit", "fx", "width", "T_world_camera"])
def test_a_missing_key(folder, key):
    broken = {name: value for name, value in entry().items() if name != key}
    with pytest.raises(SceneError, match=f"view 0: the key '{key}' is missing; expected depth, fx"):
        load_views(written(folder, broken))


@pytest.mark.parametrize("value", ["50", True, None, 10**400, [50.0]])
@pytest.mark.parametrize("key", ["fx", "cy", "depth_unit", "width"])
def test_values_that_are_no_numbers(folder, key, value):
    shown = "an integer of 401 digits" if value == 10**400 else repr(value)
    assert refusal(folder, **{key: value}).endswith(f"{key} is {shown}; expected a finite number")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"fx": 0.0}, "the focal length fx is 0 px; expected a positive one"),
        ({"fy": -52.0}, "the focal length fy is -52 px; expected a positive one"),
        ({"fx": 0.96}, "in pixels, not in millimetres or parts of the image"),
        ({"cx": 1e4}, "the principal point cx is 10000 px; expected it near the image of 40 px"),
        ({"width": 0}, "width is 0; expected a whole number of pixels"),
        ({"height": 29.5}, "height is 29.5; expected a whole number of pixels"),
        ({"width": 10**6, "height": 10**6}, "expected at most 64,000,000"),
        ({"width": 41}, "has 40 x 30 pixels; expected 41 x 30, as its camera says"),
        ({"depth_unit": 1}, "m in the median; expected 0.02 to 20 m"),
        ({"depth_unit": 1e-6}, "m in the median; expected 0.02 to 20 m"),
        ({"depth_unit": -0.001}, "depth_unit is -0.001; expected the metres of one step"),
        ({"depth_unit": 1e308}, "depth_unit is 1e+308; expected the metres of one step"),
        ({"depth": "\ud800"}, "which is no path"),
        ({"depth": "../depth.png"}, "depth is '../depth.png', outside the folder of cameras.json"),
        ({"depth": "/etc/passwd"}, "outside the folder of cameras.json"),
        ({"depth": 7}, "depth is 7; expected a path relative to the folder of cameras.json"),
        ({"depth": "none.png"}, "none.png: no such file; expected a PNG of 40 x 30"),
        ({"depth": "a" * 300}, "expected a PNG of 40 x 30"),
        ({"depth": "."}, "no such file; expected a PNG of 40 x 30"),
        ({"depth": "cameras.json"}, "is no PNG; expected a PNG of 40 x 30"),
        ({"depth": "mask.png"}, "has 8 bits, grey; expected a depth image of 16 bits"),
        ({"mask": "empty.png"}, "the mask has no pixel; expected the object's; leave out `mask`"),
        ({"mask": "none.png"}, "no such file"),
        ({"T_world_camera": np.diag([1.0, 1, -1, 1]).tolist()}, "it mirrors: was it written in a left-handed frame?"),
        ({"T_world_camera": np.diag([2.0, 2, 2, 1]).tolist()}, "T_world_camera is not a rigid transform"),
        ({"T_world_camera": np.eye(3).tolist()}, "T_world_camera has shape (3, 3); expected (4, 4)"),
        ({"T_world_camera": [[1, 2], [3]]}, "T_world_camera: a value is [1, 2]; expected a finite number"),
        ({"T_world_camera": np.eye(4).astype(str).tolist()}, "T_world_camera: a value is '1.0'"),
        ({"T_world_camera": np.eye(4, dtype=bool).tolist()}, "T_world_camera: a value is True"),
    ],
)
def test_an_entry_that_is_no_camera(folder, changes, text):
    assert text in refusal(folder, **changes)


def test_rotations_that_were_rounded_become_exact(folder):
    [view] = load_views(written(folder, entry(T_world_camera=POSE.round(4).tolist())))
    rotation = view.T_world_camera[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


def test_depth_images_that_are_none(folder):
    colours = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    Image.fromarray(colours).save(folder / "colour.png")
    assert (
        "colour.png: has 8 bits, colour; expected a depth image of 16 bits, grey; is it the colour picture?"
        in refusal(folder, depth="colour.png")
    )
    Image.fromarray(np.zeros((HEIGHT, WIDTH), dtype=np.uint16)).save(folder / "zero.png")
    assert "zero.png: no pixel is measured (all are 0)" in refusal(folder, depth="zero.png")
    (folder / "cut.png").write_bytes((folder / "depth.png").read_bytes()[:600])
    assert "cut.png: cannot be read as PNG (" in refusal(folder, depth="cut.png")
    Image.fromarray(np.zeros((3, 4), dtype=np.uint8)).save(folder / "small.png")
    assert "small.png: has 4 x 3 pixels; expected 40 x 30" in refusal(folder, mask="small.png")


def test_an_image_that_announces_two_sizes_is_not_decoded(folder):
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    whole = (folder / "depth.png").read_bytes()
    huge = chunk(b"IHDR", struct.pack(">IIBBBBB", 9000, 9000, 16, 0, 0, 0, 0))
    (folder / "bomb.png").write_bytes(whole[:33] + huge + whole[33:])
    assert "bomb.png: cannot be read as PNG (it announces its size twice)" in refusal(folder, depth="bomb.png")


def test_files_that_hold_no_views(folder, monkeypatch):
    def message(content: str) -> str:
        (folder / "cameras.json").write_text(content)
        with pytest.raises(SceneError) as caught:
            load_views(folder)
        return str(caught.value).removeprefix(f"{folder / 'cameras.json'}: ")

    assert message("{}") == "holds a JSON dict; expected a list with an entry for each view"
    assert message("[]") == "0 views; expected 1 to 256"
    assert message("[3]") == "view 0 is a JSON int; expected an object with named values"
    assert message("[NaN]").startswith("cannot be read as JSON (NaN is not a JSON number)")
    assert message("[" + "1," * 300 + "1]") == "301 views; expected 1 to 256"
    monkeypatch.setattr(views, "MAX_ALL_PIXELS", 2000)
    assert message(json.dumps([entry(), entry()])) == "2,400 pixels up to view 1; expected at most 2,000"
    with pytest.raises(SceneError, match="no such file; expected a JSON file"):
        load_views(folder / "elsewhere")
    with pytest.raises(SceneError, match="each name of at most 255 bytes"):
        load_views("a" * 300)


def test_arrays_that_are_no_view():
    depth = np.full((HEIGHT, WIDTH), 0.5)

    def message(**changes) -> str:
        with pytest.raises(SceneError) as caught:
            DepthView(**{"depth": depth, **CAMERA, "T_world_camera": np.eye(4), **changes})
        return str(caught.value)

    assert message(depth=0 * depth).startswith("view: no pixel is measured")
    assert message(depth=depth - 0.6, name="left").startswith("left: depth is negative, -0.1 m")
    assert message(fx=float("nan")) == "view: fx is nan; expected a finite number"
    assert message(T_world_camera=np.diag([1.0, 1, -1, 1])).startswith("view: T_world_camera is not a rigid")
