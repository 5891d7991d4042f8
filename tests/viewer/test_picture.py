import tracemalloc

import numpy as np
import pytest
import trimesh
from PIL import Image

import dexnudge as dn
from dexnudge.errors import InputError, OutputError
from dexnudge.viewer.camera import Camera, choose_camera
from dexnudge.viewer.picture import ray_scene, render_array, render_png
from dexnudge.viewer.visual_scene import PALETTE, Part, VisualScene, legend, visual_scenes

SIZE = (200, 150)
LEAST_SEEN = 0.6  # of the object's pixels
UP = np.array([0.0, 0.0, 1.0])


def at(*translation):
    return trimesh.transformations.translation_matrix(translation)


def box(role, extents, *translation):
    return Part(role, role, trimesh.creation.box(extents), at(*translation))


def looking_along_y(distance):
    """A camera at y = -distance that looks at the origin."""
    tangent = 0.25
    return Camera(
        np.array([0, -distance, 0.0]), np.array([1.0, 0, 0]), UP, np.array([0, 1.0, 0]), tangent * 4 / 3, tangent
    )


def linear(colour):
    value = np.asarray(colour, dtype=float)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def is_role(picture, role):
    """Pixels whose hue is nearest to that of a role's colour."""
    pixels = linear(picture / 255.0)
    hues = {name: linear(colour) / np.linalg.norm(linear(colour)) for name, colour in PALETTE.items()}
    names = list(hues)
    cosines = pixels @ np.stack([hues[name] for name in names]).T
    return np.argmax(cosines, axis=2) == names.index(role)


def test_silhouette_of_a_sphere_has_the_area_of_its_tangent_cone():
    radius, distance = 0.05, 0.5
    ball = Part("ball", "object", trimesh.creation.icosphere(subdivisions=5, radius=radius), np.eye(4))
    away = VisualScene((ball,), np.zeros((0, 3)), np.array([0, 1.0, 0]))  # the arrow is hidden behind the ball
    camera = looking_along_y(distance)
    picture = render_array(away, size=SIZE, camera=camera)
    outline = radius / np.sqrt(distance**2 - radius**2) / camera.tan_height * SIZE[1] / 2  # pixels
    assert is_role(picture, "object").sum() == pytest.approx(np.pi * outline**2, rel=0.02)


def test_pixels_have_the_colours_of_what_is_there():
    parts = (box("object", (0.1, 0.1, 0.02), 0, 0, 0), box("link", (0.02, 0.02, 0.02), -0.09, 0, 0))
    shown = VisualScene(parts, np.array([[0.03, -0.05, 0.0]]), np.array([1.0, 0, 0]))
    picture = render_array(shown, size=SIZE, camera=looking_along_y(0.5))

    def pixel(x, z, y=-0.05):
        scale = SIZE[1] / 2 / 0.25 / (0.5 + y)
        return round(SIZE[1] / 2 - z * scale), round(SIZE[0] / 2 + x * scale)

    for place, role in (((-0.02, 0.0), "object"), ((0.03, 0.0), "contact"), ((0.08, 0.0, 0.0), "arrow")):
        shade = linear(picture[pixel(*place)] / 255.0) / linear(PALETTE[role])
        assert shade.min() > 0.2
        assert shade.max() < 1.3
        assert shade.max() / shade.min() < 1.35  # the hue is kept
    grey = picture[pixel(-0.09, 0.0, -0.01)].astype(int)
    assert np.ptp(grey) < 30
    assert picture[2, 2].min() > 220  # background


def test_shadow_falls_away_from_the_light_and_contact_darkens():
    floor = box("environment", (2.0, 2.0, 0.02), 0, 0, -0.01)
    cube = box("object", (0.05, 0.05, 0.05), 0, 0, 0.026)
    shown = VisualScene((cube, floor), np.zeros((0, 3)), np.array([0, 1.0, 0]))
    forward = np.array([0, 1.0, -1.0]) / np.sqrt(2)
    camera = Camera(np.array([0, -0.4, 0.4]), np.array([1.0, 0, 0]), np.cross([1.0, 0, 0], forward), forward, 0.4, 0.3)
    row = render_array(shown, size=SIZE, camera=camera)[SIZE[1] // 2].astype(int).sum(axis=1)
    left, right = row[SIZE[0] // 2 - 16], row[SIZE[0] // 2 + 16]  # the light stands to the left of the camera
    assert right < left - 60


def test_a_wall_in_front_becomes_glass_and_one_behind_stays_solid():
    cube = box("object", (0.05, 0.05, 0.05), 0, 0, 0)
    walls = (box("environment", (0.4, 0.01, 0.4), 0, -0.1, 0), box("environment", (0.4, 0.01, 0.4), 0, 0.1, 0))
    camera = looking_along_y(0.5)
    away = np.array([0, 1.0, 0])
    middle = SIZE[1] // 2, SIZE[0] // 2
    covered = render_array(VisualScene((cube, *walls), np.zeros((0, 3)), away), size=SIZE, camera=camera)
    free = render_array(VisualScene((cube, walls[1]), np.zeros((0, 3)), away), size=SIZE, camera=camera)
    assert is_role(covered, "object")[middle]
    assert np.abs(covered[middle].astype(int) - free[middle]).max() > 5
    corner = linear(free[20, 20] / 255.0) / linear(PALETTE["environment"])
    assert corner.max() / corner.min() < 1.2


@pytest.mark.parametrize("role", ["base", "arm"])
def test_a_base_in_front_becomes_glass_and_one_aside_stays_solid(role):
    cube, away = box("object", (0.05, 0.05, 0.05), 0, 0, 0), np.array([0, 1.0, 0])
    for aside in (0.0, 0.12):
        hand = box(role, (0.08, 0.05, 0.08), aside, -0.1, 0)
        shown = VisualScene((cube, hand), np.zeros((0, 3)), away)
        picture = render_array(shown, size=SIZE, camera=looking_along_y(0.5))
        assert is_role(picture, "object")[SIZE[1] // 2, SIZE[0] // 2]
        there = SIZE[1] // 2, round(SIZE[0] / 2 + 0.12 * SIZE[1] / 2 / 0.25 / 0.375)
        light = picture[there].astype(int) - render_array(
            VisualScene((cube,), np.zeros((0, 3)), away), size=SIZE, camera=looking_along_y(0.5)
        )[there].astype(int)
        assert (np.abs(light).max() > 5) == (aside > 0)


@pytest.fixture(scope="module", params=["shadow_lite", "allegro"])
def sampler(request):
    return dn.Sampler(dn.load_hand(request.param))


@pytest.mark.slow
@pytest.mark.parametrize("family", ["table", "layers", "shelf"])
def test_most_of_the_object_is_seen(sampler, family):
    """Pixels of the object's hue in the picture, against those in a picture of the object alone from there."""
    scene = dn.build_scene(family, "phone", seed=0)
    samples = sampler.sample(scene, num=4, seed=0)
    for shown in visual_scenes(scene, sampler.hand, samples.q[:2].astype(float)):
        camera = choose_camera(shown, aspect=SIZE[0] / SIZE[1])
        alone = VisualScene(shown.with_role("object"), np.zeros((0, 3)), np.zeros(3))
        seen, whole = (is_role(render_array(each, size=SIZE, camera=camera), "object").sum() for each in (shown, alone))
        assert seen > LEAST_SEEN * whole > 300


def test_open_surroundings_show_both_sides():
    sheet = trimesh.Trimesh([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], [[0, 1, 2], [0, 2, 3]], process=False)
    cube = box("object", (0.02, 0.02, 0.02), 0, 0, 0)
    for turned in (sheet, trimesh.Trimesh(sheet.vertices, sheet.faces[:, ::-1], process=False)):
        parts = (cube, Part("scan", "environment", turned, at(0, 0.1, 0)))
        picture = render_array(
            VisualScene(parts, np.zeros((0, 3)), np.array([0, 1.0, 0])), size=SIZE, camera=looking_along_y(0.5)
        )
        assert picture[20, 20, 0] > picture[20, 20, 2]  # the warm tone of the surroundings, not the cool background


def test_same_drawing_same_bytes_on_any_number_of_cores(monkeypatch):
    parts = (box("object", (0.1, 0.06, 0.01), 0, 0, 0.005), box("environment", (0.5, 0.5, 0.02), 0, 0, -0.01))
    shown = VisualScene(parts, np.array([[0.0, 0.0, 0.01]]), np.array([1.0, 0, 0]))
    first = render_array(shown, size=SIZE)
    np.testing.assert_array_equal(render_array(shown, size=SIZE), first)
    monkeypatch.setattr("dexnudge.viewer.picture.thread_count", lambda: 1)
    np.testing.assert_array_equal(render_array(shown, size=SIZE), first)


def test_triangles_are_packed_with_few_copies():
    ball = Part("ball", "object", trimesh.creation.icosphere(subdivisions=6, radius=0.05), np.eye(4))
    shown, camera = VisualScene((ball,), np.zeros((0, 3)), np.array([0, 1.0, 0])), looking_along_y(0.5)
    ray_scene(shown, camera)  # what the mesh keeps is made
    tracemalloc.start()
    try:
        _, trees = ray_scene(shown, camera)
        most = tracemalloc.get_traced_memory()[1]
        assert len(trees) == 3
        assert most < 600 * len(ball.mesh.faces)  # [bytes]; a triangle takes 92 in the table and 48 in each tree
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("rows", [1, 7, 149])
def test_a_picture_made_in_bands_is_the_same(rows, monkeypatch):
    parts = (box("object", (0.1, 0.06, 0.01), 0, 0, 0.005), box("environment", (0.5, 0.5, 0.02), 0, 0, -0.01))
    shown = VisualScene(parts, np.array([[0.0, 0.0, 0.01]]), np.array([1.0, 0, 0]))
    whole = render_array(shown, size=SIZE)
    monkeypatch.setattr("dexnudge.viewer.picture.BAND", rows * SIZE[0] + 1)
    np.testing.assert_array_equal(render_array(shown, size=SIZE), whole)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_camera_stands_where_the_contact_is_seen(side):
    tall = box("object", (0.06, 0.06, 0.2), 0, 0, 0.1)
    shown = VisualScene((tall,), np.array([[side * 0.03, 0.0, 0.05]]), np.array([0, 1.0, 0]))
    assert choose_camera(shown, aspect=4 / 3).position[0] * side > 0.03


def test_picture_is_written_as_png(tmp_path):
    shown = VisualScene((box("object", (0.1, 0.06, 0.01), 0, 0, 0),), np.zeros((0, 3)), np.array([1.0, 0, 0]))
    path = render_png(shown, tmp_path / "view.png", size=(64, 48))
    with Image.open(path) as image:
        assert (image.format, image.size, image.mode) == ("PNG", (64, 48), "RGB")
    with pytest.raises(OutputError, match="cannot write"):
        render_png(shown, tmp_path / "missing" / "view.png", size=(8, 8))


def test_a_legend_names_what_is_shown_and_nothing_else(tmp_path):
    parts = (box("object", (0.05, 0.05, 0.05), 0, 0, 0), box("ghost", (0.05, 0.05, 0.05), 0.1, 0, 0))
    still = VisualScene(parts[:1], np.zeros((0, 3)), np.zeros(3))
    moved = VisualScene(parts, np.zeros((1, 3)), np.array([1.0, 0, 0]))
    assert list(legend([still])) == ["object"]
    carried = VisualScene((*parts[:1], box("base", (0.05, 0.05, 0.05), 0, 0, 0.1)), np.zeros((0, 3)), np.zeros(3))
    assert list(legend([carried])) == ["object", "forearm"]
    shown = legend([still, moved])
    assert list(shown) == ["object", "where the object comes (see-through)", "contacts (balls)", "motion (arrows)"]
    with Image.open(render_png(moved, tmp_path / "p.png", size=(640, 480))) as picture:
        row = np.asarray(picture)[-20:].reshape(-1, 3)
    for colour in shown.values():
        assert (row == np.rint(255 * np.array(colour))).all(axis=1).sum() > 30


def test_a_picture_needs_a_size():
    shown = VisualScene((box("object", (0.1, 0.06, 0.01), 0, 0, 0),), np.zeros((0, 3)), np.array([1.0, 0, 0]))
    with pytest.raises(InputError, match="0 x 4 pixels was asked for; expected at least 1 x 1"):
        render_array(shown, size=(0, 4))
