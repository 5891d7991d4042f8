"""Every family: what it promises, measured on the meshes that it makes."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, cKDTree

from dexnudge.errors import MeshError, SceneError, UnknownNameError
from dexnudge.geometry.overlap import deepest_overlap
from dexnudge.objects.builtin import builtin_object
from dexnudge.scenes.families import SCENE_FAMILIES, build_scene
from dexnudge.scenes.free_way import free_way
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts

OBJECTS = ["phone", "phone-003", "remote-003", "remote-201", "book-200", "box-004"]
SEEDS = range(2)


@pytest.fixture(scope="module")
def meshes() -> dict[str, trimesh.Trimesh]:
    return {name: builtin_object(name) for name in OBJECTS}


def drawn(family: str, meshes: dict[str, trimesh.Trimesh], names=OBJECTS, seeds=SEEDS) -> list[Scene]:
    return [build_scene(family, meshes[name], seed=seed) for name in names for seed in seeds]


def parts_of(scene: Scene) -> list[trimesh.Trimesh]:
    """The bodies of the surroundings, largest first."""
    return sorted(scene.environment_mesh.split(only_watertight=False), key=lambda part: -part.volume)


def gap_along(scene: Scene, axis: int, side: int, limit: float) -> float:
    """From the object's bounding box to the plane at `limit`, on its low (0) or high (1) side."""
    return (1 if side else -1) * (limit - scene.object_in_world().bounds[side, axis])


@pytest.mark.parametrize("family", SCENE_FAMILIES)
def test_the_surroundings_are_closed_bodies_that_stay_apart_when_saved(family, meshes):
    for scene in drawn(family, meshes, OBJECTS[:2], [0]):
        environment = scene.environment_mesh
        parts = parts_of(scene)
        assert all(part.is_watertight and part.volume > 0 and part.is_convex for part in parts)
        merged = environment.copy()
        merged.merge_vertices()
        assert len(merged.vertices) == len(environment.vertices) == 8 * len(parts)


@pytest.mark.parametrize("family", SCENE_FAMILIES)
def test_the_object_touches_its_support_and_penetrates_nothing(family, meshes):
    for scene in drawn(family, meshes, OBJECTS[1::2]):
        placed = scene.object_in_world()
        up = scene.environment_mesh.face_normals[2] if family == "ramp" else np.array([0.0, 0.0, 1.0])
        heights = placed.vertices @ up
        support = (
            scene.parameters["thickness_lower"] + scene.parameters["thickness_upper"] if family == "stack" else 0.0
        )
        assert heights.min() == pytest.approx(support, abs=1e-9)
        if family != "book":  # which may stand on a round end, between its neighbours
            assert np.count_nonzero(heights < support + 1e-6) >= 3
        assert deepest_overlap(placed, scene.environment_mesh)[0] < 1e-6


@pytest.mark.parametrize("family", SCENE_FAMILIES)
def test_the_seed_decides(family, meshes):
    first, again, other = (build_scene(family, meshes["phone"], seed=seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(first.T_world_object, again.T_world_object)
    np.testing.assert_array_equal(first.environment_mesh.vertices, again.environment_mesh.vertices)
    assert first.parameters == again.parameters
    assert first.parameters != other.parameters
    assert (first.name, first.seed) == (family, 7)
    assert np.linalg.norm(first.motion) == pytest.approx(1)
    if family == "book":
        assert 0.06 <= first.motion_length <= 0.08
    else:
        assert first.motion_length == (0.0 if family in ("turn", "edge") else 0.10)


@pytest.mark.parametrize("family", SCENE_FAMILIES)
def test_the_object_does_not_run_into_the_surroundings(family, meshes):
    for scene in drawn(family, meshes, OBJECTS[1:3]):
        moved = scene.object_in_world()
        moved.apply_transform(scene.object_motion.displacement(scene.object_motion.length))
        moved.apply_translation(1e-6 * scene.environment_mesh.face_normals[2])
        assert deepest_overlap(moved, scene.environment_mesh)[0] < (1e-5 if scene.turn is None else 1e-3)


def test_table(meshes):
    edges = set()
    for scene in drawn("table", meshes, OBJECTS[:3], range(24)):
        axis = int(np.argmax(np.abs(scene.motion)))
        side = int(scene.motion[axis] > 0)
        assert 0.10 <= gap_along(scene, axis, side, scene.environment_mesh.bounds[side, axis]) <= 0.30
        np.testing.assert_allclose(scene.environment_mesh.extents, [1.2, 0.8, 0.04])
        edges.add((axis, side))
    assert len(edges) == 4


@pytest.mark.parametrize(
    ("family", "gaps", "exposed"), [("layers", (0.010, 0.030), (0.2, 0.5)), ("slot", (0.003, 0.008), (0.1, 0.2))]
)
def test_layers_and_slot(family, gaps, exposed, meshes):
    for scene in drawn(family, meshes):
        low, high = scene.object_in_world().bounds
        lower, upper = sorted(parts_of(scene), key=lambda part: part.bounds[0, 2])
        assert high[0] == pytest.approx(lower.bounds[1, 0], abs=1e-9)
        assert gaps[0] <= upper.bounds[0, 2] - high[2] <= gaps[1]
        assert exposed[0] <= (high[0] - upper.bounds[1, 0]) / (high[0] - low[0]) <= exposed[1]
        assert high[0] - low[0] == pytest.approx(scene.object_mesh.extents.max(), rel=2e-2)
        for board in (lower, upper):
            assert board.extents[0] == pytest.approx(0.30)
            assert board.extents[2] == pytest.approx(0.02)
        np.testing.assert_array_equal(scene.motion, [1, 0, 0])


@pytest.mark.parametrize(
    ("family", "heights", "gaps"), [("shelf", (0.16, 0.24), (0.010, 0.060)), ("deep", (0.12, 0.16), (0.08, 0.18))]
)
def test_shelf_and_deep(family, heights, gaps, meshes):
    for scene in drawn(family, meshes):
        low, high = scene.object_in_world().bounds
        parts = parts_of(scene)
        floor, ceiling = (min(parts, key=lambda part, s=s: s * part.bounds.mean(axis=0)[2]) for s in (1, -1))
        left, right = (min(parts, key=lambda part, s=s: s * part.bounds.mean(axis=0)[1]) for s in (1, -1))
        back = min(parts, key=lambda part: part.bounds.mean(axis=0)[0])
        assert 0.28 <= right.bounds[0, 1] - left.bounds[1, 1] <= 0.40
        assert heights[0] <= ceiling.bounds[0, 2] - floor.bounds[1, 2] <= heights[1]
        assert floor.bounds[1, 0] - back.bounds[1, 0] == pytest.approx(0.30)
        assert gaps[0] <= floor.bounds[1, 0] - high[0] <= gaps[1]
        assert low[0] > back.bounds[1, 0]
        assert left.bounds[1, 1] < low[1] < high[1] < right.bounds[0, 1]
        np.testing.assert_array_equal(scene.motion, [1, 0, 0])


def test_corner(meshes):
    for scene in drawn("corner", meshes):
        low, _ = scene.object_in_world().bounds
        _, *walls = parts_of(scene)
        across_x = min(walls, key=lambda part: part.extents[0])
        across_y = min(walls, key=lambda part: part.extents[1])
        assert 0 <= low[0] - across_x.bounds[1, 0] <= 0.005
        assert 0 <= low[1] - across_y.bounds[1, 1] <= 0.005
        np.testing.assert_allclose(scene.motion, [np.sqrt(0.5), np.sqrt(0.5), 0])


def test_clutter(meshes):
    for scene in drawn("clutter", meshes):
        _, *boxes = parts_of(scene)
        assert len(boxes) == 6
        # From above everything is a prism: the distance of the outlines is that of dense points on their edges.
        corners = scene.object_in_world().convex_hull.vertices[:, :2]
        for box in boxes:
            around = box.vertices[box.vertices[:, 2] > 1e-9][:, :2]
            nearest = min_distance(hull_points(corners), hull_points(around))
            assert 0.003 < nearest <= 0.020
            assert np.all(np.abs(around) <= [0.6, 0.4])


def hull_points(points: np.ndarray) -> np.ndarray:
    """Points every half millimetre along the convex hull of points in the plane."""
    outline = points[ConvexHull(points).vertices]
    pieces = []
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        steps = max(2, int(np.linalg.norm(end - start) / 5e-4))
        pieces.append(start + np.linspace(0, 1, steps)[:, None] * (end - start))
    return np.concatenate(pieces)


def min_distance(first: np.ndarray, second: np.ndarray) -> float:
    return float(cKDTree(first).query(second)[0].min())


def test_turn(meshes):
    turned = set()
    for scene in drawn("turn", meshes, seeds=range(6)):
        turn, centre = scene.turn, scene.object_in_world().center_mass
        assert turn.angle == pytest.approx(np.pi / 2)
        assert abs(turn.axis[2]) == 1.0
        np.testing.assert_allclose(turn.point[:2], centre[:2], atol=1e-6)
        turned.add(float(turn.axis[2]))
        low, high = scene.way_bounds()
        assert (np.abs([low[:2], high[:2]]).max(axis=0) <= [0.6, 0.4]).all()
    assert turned == {-1.0, 1.0}


def test_book(meshes):
    for scene in drawn("book", meshes, ["phone", "phone-003", "remote-003", "book-200"]):
        low, high = scene.object_in_world().bounds
        assert (high - low)[2] >= (high - low)[0] >= (high - low)[1]
        board, *neighbours = parts_of(scene)
        assert high[0] + 0.10 <= board.bounds[1, 0] <= high[0] + 0.14
        left, right = sorted(neighbours, key=lambda part: part.bounds[0, 1])
        for side, neighbour in ((-1, left), (1, right)):
            beside = scene.object_in_world().vertices
            beside = beside[beside[:, 2] <= neighbour.bounds[1, 2]]  # above it may be wider
            gap = side * neighbour.bounds[(1 - side) // 2, 1] - (side * beside[:, 1]).max()
            assert 0.0003 <= gap <= 0.0008
            assert 0.70 <= neighbour.bounds[1, 2] / high[2] <= 0.95
            assert abs(neighbour.bounds[1, 0] - high[0]) <= 0.003
        np.testing.assert_array_equal(scene.turn.axis, [0, 1, 0])
        assert 20 <= np.degrees(scene.turn.angle) <= 30
        assert scene.turn.point[2] == pytest.approx(0.0, abs=1e-6)
        assert low[0] < scene.turn.point[0] <= high[0]
        touched = support_contacts(scene)
        assert {-1, 0, 1} == set(touched.normals[:, 1].round(9))  # carried from below, held from both sides


def slab_on_feet(*ends: float) -> trimesh.Trimesh:
    """A slab with a foot 5 mm wide at one side of each of these ends (-1, 1), about which it falls over."""
    slab = trimesh.creation.box((0.15, 0.05, 0.012))
    feet = [trimesh.creation.box((0.02, 0.005, 0.012)) for _ in ends]
    for foot, end in zip(feet, ends, strict=True):
        foot.apply_translation([end * 0.085, 0.0225, 0.0])
    return trimesh.convex.convex_hull(np.concatenate([part.vertices for part in (slab, *feet)]))


def test_a_book_stands_on_the_end_on_which_it_does_not_fall_over():
    for seed in range(6):
        scene = build_scene("book", slab_on_feet(1.0), seed=seed)
        touched = support_contacts(scene)
        feet = touched.points[touched.normals[:, 2] > 0.5, 0]
        assert feet.min() < scene.centre_of_mass[0] - 0.02
        assert feet.max() > scene.centre_of_mass[0] + 0.02
    with pytest.raises(SceneError, match="stands upright on neither end"):
        build_scene("book", slab_on_feet(-1.0, 1.0), seed=0)


def test_a_book_with_a_round_foot_tips_as_far_as_that_lets_it():
    across = np.linspace(-0.035, 0.035, 25)
    end = 0.075 - across**2 / (2 * 0.07)
    outline = np.concatenate([np.stack([side * end, across], axis=1) for side in (-1, 1)])
    corners = np.concatenate([np.insert(outline, 2, height, axis=1) for height in (-0.006, 0.006)])
    scenes = [build_scene("book", trimesh.convex.convex_hull(corners), seed=seed) for seed in range(6)]
    assert all(free_way(scene).whole for scene in scenes)
    tipped = [np.degrees(scene.turn.angle) for scene in scenes]
    assert min(tipped) >= 20
    assert max(tipped) < 24
    assert tipped == [scene.parameters["tip_degrees"] for scene in scenes]


def test_edge(meshes):
    for scene in drawn("edge", meshes):
        axis = int(np.argmax(np.abs(scene.motion)))
        rim = np.array([0.6, 0.4])[axis]
        along = scene.object_in_world().vertices @ scene.motion
        assert 0.35 <= (along.max() - rim) / np.ptp(along) <= 0.45
        foremost = scene.turn.point @ scene.motion  # of a curved underside a little behind the table's edge
        assert rim - 0.010 <= foremost <= rim + 1e-6
        assert foremost - scene.object_in_world().center_mass @ scene.motion >= 0.05 * np.ptp(along) - 1e-6
        assert 20 <= np.degrees(scene.turn.angle) <= 35
        np.testing.assert_allclose(scene.turn.axis, np.cross([0, 0, 1], scene.motion))


@pytest.mark.parametrize("degrees", [30.0, -30.0])
def test_a_corner_is_left_by_a_turn_and_a_slide(degrees, meshes):
    for name in OBJECTS[:3]:
        scene = build_scene("corner", meshes[name], seed=1, turn_deg=degrees)
        assert scene.motion_length == 0.10
        assert scene.turn.axis[2] == pytest.approx(np.sign(degrees))
        assert free_way(scene).whole


def test_drawer(meshes):
    for scene in drawn("drawer", meshes):
        low, _ = scene.object_in_world().bounds
        _, *walls = parts_of(scene)
        behind = min(walls, key=lambda part: part.bounds.mean(axis=0)[0])
        assert 0.010 <= low[0] - behind.bounds[1, 0] <= 0.040
        assert len(walls) == 4


def test_ramp(meshes):
    for scene in drawn("ramp", meshes, seeds=range(6)):
        assert scene.motion[2] == pytest.approx(-np.sin(np.radians(15)))
        upward = scene.environment_mesh.face_normals[2]
        assert upward[2] == pytest.approx(np.cos(np.radians(15)))
        assert upward @ scene.motion == pytest.approx(0, abs=1e-12)


def test_stack(meshes):
    for scene in drawn("stack", meshes):
        low, high = scene.object_in_world().bounds
        _, *books = parts_of(scene)
        upper = max(books, key=lambda part: part.bounds[1, 2])
        lower = min(books, key=lambda part: part.bounds[1, 2])
        gaps = np.stack([low - upper.bounds[0], upper.bounds[1] - high])[:, :2]  # side, axis
        assert gaps.min() >= 0.005 - 1e-9
        side, axis = np.unravel_index(np.argmin(gaps), (2, 2))
        assert scene.motion[axis] == (1.0 if side else -1.0)
        assert np.all(lower.bounds[0, :2] <= upper.bounds[0, :2])
        assert np.all(lower.bounds[1, :2] >= upper.bounds[1, :2])


def test_physics_come_from_the_caller(meshes):
    scene = build_scene("table", meshes["phone"], seed=0, mass=0.3, friction_environment=0.2, motion_length=0.05)
    assert (scene.mass, scene.friction_environment, scene.motion_length) == (0.3, 0.2, 0.05)
    assert (scene.friction_hand, scene.max_normal_force) == (0.8, 5.0)


def test_a_mesh_that_is_none_is_refused():
    broken = trimesh.creation.box((0.15, 0.07, 0.01))
    broken.vertices[0] = np.nan
    for mesh in (broken, trimesh.Trimesh()):
        with pytest.raises(MeshError, match="has no faces, or vertices that are NaN"):
            build_scene("table", mesh)


def test_an_unknown_family_lists_the_known_ones(meshes):
    with pytest.raises(UnknownNameError) as caught:
        build_scene("tabel", meshes["phone"], seed=0)
    assert str(caught.value) == (
        "unknown scene 'tabel' (did you mean 'table'?); expected one of table, layers, shelf, slot, deep, corner, clutter, "
        "turn, book, edge, drawer, ramp, "
        "stack, or your own surroundings through `environment`"
    )
    with pytest.raises(SceneError) as caught:
        build_scene("table", meshes["phone"], seed=0, weight=1.0)
    assert str(caught.value) == (
        "unknown physical parameter 'weight'; expected motion_length, mass, friction_hand, friction_environment, "
        "max_normal_force"
    )


@pytest.mark.parametrize(
    ("family", "size", "expected"),
    [
        ("layers", (0.35, 0.1, 0.02), "the object is 0.350 m long; expected at most 0.3 m, the depth of the boards of "),
        ("shelf", (0.25, 0.25, 0.20), "the object lies 0.250 x 0.250 m and 0.200 m high; expected one that fits 0.285 x "),
        ("deep", (0.15, 0.12, 0.11), "the object lies 0.150 x 0.120 m and 0.110 m high; expected one that fits 0.215 x "),
        ("drawer", (0.5, 0.5, 0.02), "the object lies 0.500 x 0.500 m; expected at most "),
        ("stack", (0.59, 0.59, 0.05), "the object covers "),
        ("table", (0.59, 0.59, 0.05), "the object covers "),
    ],
)  # fmt: skip
def test_an_object_that_does_not_fit_is_refused(family, size, expected):
    mesh = trimesh.creation.box(size)
    with pytest.raises(SceneError) as caught:
        for seed in range(20):
            build_scene(family, mesh, seed=seed)
    assert str(caught.value).startswith(expected)
    assert str(caught.value).endswith("use a smaller object or your own environment")
