"""What stands in an object's way, in surroundings of which it is known by hand."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from dexnudge.scenes.boxes import box, joined
from dexnudge.scenes.families import SCENE_FAMILIES, build_scene
from dexnudge.scenes.free_way import free_way
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts

LENGTH, WIDTH, HEIGHT = 0.15, 0.07, 0.01  # [m] of the slab, whose front stands at x = 0
FLOOR = box((-0.5, -0.4, -0.02), (0.5, 0.4, 0.0))
TURNED = trimesh.transformations.rotation_matrix(0.7, [0.1, 0.05, 1.0], [0.1, -0.2, 0.3])  # oblique to every axis


def slab_scene(*others, floor=FLOOR, size=(LENGTH, WIDTH, HEIGHT), turn=None, noise=0.0):
    """A slab on a floor at z = 0 that is to slide along x, and whatever else there is; all of it turned, if so wished."""
    pose = np.eye(4)
    pose[:3, 3] = -size[0] / 2, 0.0, size[2] / 2
    environment = trimesh.util.concatenate([floor, *others])
    motion = np.array([1.0, 0.0, 0.0])
    if turn is not None:
        environment.apply_transform(turn)
        pose, motion = turn @ pose, turn[:3, :3] @ motion
    return Scene(trimesh.creation.box(size), environment, pose, motion, surface_noise=noise, clearance=noise)


def sheet(corners, *, flipped=False):
    """A single layer with these four corners."""
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return trimesh.Trimesh(corners, faces[:, ::-1] if flipped else faces, process=False)


def spike(x, y, height, width=0.004):
    """A pyramid on the floor, as a stray point in a scan makes one."""
    base = [[x + i * width, y + j * width, 0.0] for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return trimesh.Trimesh([*base, [x, y, height]], [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], process=False)


@pytest.mark.parametrize("turn", [None, TURNED])
def test_what_stands_in_the_way_is_named_with_its_place_and_its_height(turn):
    found = free_way(slab_scene(box((0.041, -0.01, 0.0), (0.06, 0.03, 0.006)), turn=turn))
    assert not found.whole
    assert found.length == pytest.approx(0.041, abs=1e-6)
    assert found.height == pytest.approx(0.006, abs=1e-6)
    place = found.place if turn is None else np.linalg.inv(turn)[:3] @ [*found.place, 1.0]
    assert place[0] == pytest.approx(0.041, abs=1e-6)
    assert -0.01 <= place[1] <= 0.03
    assert str(found).startswith("blocked after 41 mm by something 6 mm high at (")


@pytest.mark.parametrize(
    "thing",
    [
        box((0.03, -0.3, 0.0), (0.05, 0.3, 0.2)),  # a wall
        box((0.03, -0.0005, 0.0), (0.031, 0.0005, 0.2)),  # a post thinner than the distance between points
        box((0.03, -0.3, 0.0095), (0.05, 0.3, 0.2)),  # a lintel, half a millimetre too low
        sheet([[0.03, -0.3, 0.0], [0.03, 0.3, 0.0], [0.03, 0.3, 0.2], [0.03, -0.3, 0.2]]),
        sheet([[0.03, -0.3, 0.0], [0.03, 0.3, 0.0], [0.03, 0.3, 0.2], [0.03, -0.3, 0.2]], flipped=True),
    ],
    ids=["wall", "post", "lintel", "sheet", "flipped"],
)
@pytest.mark.parametrize("turn", [None, TURNED])
def test_walls_posts_and_sheets_are_obstacles(thing, turn):
    found = free_way(slab_scene(thing, turn=turn))
    assert found.length == pytest.approx(0.03, abs=1e-5)
    assert found.height == pytest.approx(0.2, abs=1e-5)


def test_a_small_corner_of_the_object_is_seen_by_a_large_wall():
    nose = box((0.07, 0.0004, -0.001), (0.084, 0.0024, 0.001))  # it fits between the points of the wall
    scene = slab_scene(box((0.04, -0.3, 0.0), (0.05, 0.3, 0.2)))
    scene = replace(scene, object_mesh=joined([scene.object_mesh, nose]))
    assert free_way(scene).length == pytest.approx(0.04 - 0.009, abs=1e-5)


@pytest.mark.parametrize(
    "things",
    [
        [box((0.02, -0.3, 0.0), (0.05, 0.3, 0.0012))],  # a low step
        [box((-0.2, -0.3, HEIGHT), (0.3, 0.3, 0.03))],  # a board that lies on it
        [box((0.01, -0.3, HEIGHT + 0.0005), (0.3, 0.3, 0.03))],  # one that it just fits under
        [box((-0.2, WIDTH / 2, 0.0), (0.3, 0.2, 0.05))],  # a wall that it slides along
        [box((-0.2, WIDTH / 2 - 0.0008, 0.0), (0.3, 0.2, 0.05))],  # and overlaps, as much as a scene may
        [box((-0.2, -0.2, 0.0), (-LENGTH + 0.0008, 0.2, 0.05))],  # one that it leaves
        [box((0.02, WIDTH / 2 + 0.0001, 0.0), (0.04, 0.2, 0.05))],  # one that it passes
        [box((-0.2, sign * WIDTH / 2, 0.0), (0.3, sign * 0.2, 0.05)) for sign in (-1, 1)],  # a channel
    ],
    ids=["step", "lid", "slot", "beside", "overlap", "behind", "passed", "channel"],
)
@pytest.mark.parametrize("turn", [None, TURNED])
@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_what_it_slides_along_is_no_obstacle(things, turn, noise):
    found = free_way(slab_scene(*things, turn=turn, noise=noise))
    assert found.whole, str(found)
    assert (found.length, found.place, found.height) == (0.1, None, 0.0)


@pytest.mark.parametrize("length", [0.005, 0.07, 0.12])  # single precision rounds some of these up and some down
@pytest.mark.parametrize("turn", [None, TURNED])
def test_what_it_slides_along_is_no_obstacle_over_any_length(length, turn):
    scene = slab_scene(box((-0.2, -0.3, HEIGHT), (0.3, 0.3, 0.03)), box((0.0, 0.04, 0.0), (0.2, 0.2, 0.05)), turn=turn)
    found = free_way(replace(scene, motion_length=length))
    assert (found.whole, found.length, found.place) == (True, length, None)


def test_the_drop_beyond_an_edge_is_no_obstacle():
    assert free_way(slab_scene(floor=box((-0.5, -0.4, -0.02), (0.001, 0.4, 0.0)))).whole


@pytest.mark.parametrize("thickness", [0.0008, 0.003])
@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_a_wall_stops_an_object_that_is_thinner_than_it_is_lifted(thickness, noise):
    wall = box((0.03, -0.3, 0.0), (0.05, 0.3, 0.2))
    found = free_way(slab_scene(wall, size=(LENGTH, WIDTH, thickness), noise=noise))
    assert found.length == pytest.approx(0.03, abs=1e-6)


def test_bumps_of_noisy_surfaces_are_obstacles_above_twice_the_noise():
    low, high = (free_way(slab_scene(spike(0.05, 0.0, height), noise=0.001)) for height in (0.0019, 0.006))
    assert low.whole
    assert 0.046 <= high.length <= 0.05
    assert high.height == pytest.approx(0.006, abs=1e-4)
    assert not free_way(slab_scene(spike(0.05, 0.0, 0.0019))).whole  # a model has no noise


def test_bumps_of_noisy_walls_and_ceilings_that_it_touches_are_no_obstacles():
    lid = box((-0.2, -0.3, HEIGHT), (0.3, 0.3, 0.03))
    hanging = spike(0.03, 0.0, 0.0015)
    hanging.apply_transform(np.diag([1.0, 1.0, -1.0, 1.0]))
    hanging.apply_translation([0.0, 0.0, HEIGHT])
    assert free_way(slab_scene(lid, hanging, noise=0.001)).whole
    assert not free_way(slab_scene(lid, hanging)).whole


def test_a_support_that_the_motion_runs_into_ends_the_way_at_once():
    found = free_way(slab_scene(box((0.0005, -0.3, 0.0), (0.05, 0.3, 0.02))))
    assert (found.length, found.touching, found.whole) == (0.0, True, False)
    assert found.place[0] == pytest.approx(0.0005)
    assert found.height == pytest.approx(0.02, abs=1e-5)
    assert str(found).startswith("blocked by what it touches at (0.001, ")


@pytest.mark.parametrize("family", SCENE_FAMILIES)
def test_the_way_is_free_in_the_scenes_of_every_family(family):
    scene = build_scene(family, "phone", seed=1)
    assert free_way(scene).whole
    assert free_way(replace(scene, surface_noise=0.001)).whole


def rough_floor(amplitude, cell=0.008):
    """A floor of triangles whose corners scatter evenly by so much [m]; seen from above only, as a scan is."""
    x, y = np.meshgrid(np.arange(-0.25, 0.25, cell), np.arange(-0.1, 0.1, cell), indexing="ij")
    z = np.random.default_rng(0).uniform(-amplitude, amplitude, x.shape)
    corner = np.arange(x.size).reshape(x.shape)
    low, across, along, far = corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]
    faces = np.concatenate([np.stack(three, -1).reshape(-1, 3) for three in ((low, along, far), (low, far, across))])
    return trimesh.Trimesh(np.stack([x, y, z], -1).reshape(-1, 3), faces, process=False)


def test_triangles_of_a_noisy_support_that_lean_against_the_motion_do_not_oppose_it():
    scene = slab_scene(floor=rough_floor(0.0008), noise=0.0005)
    along = support_contacts(scene).normals @ scene.motion
    assert along.min() >= -1e-3
    assert (np.abs(along) <= 1e-3).sum() >= 3
    np.testing.assert_allclose(np.linalg.norm(support_contacts(scene).normals, axis=1), 1.0)
    assert free_way(scene).whole
    as_model = replace(scene, surface_noise=0.0)
    assert (support_contacts(as_model).normals @ scene.motion).min() < -1e-3
    assert not free_way(as_model).whole


def test_a_steep_contact_of_a_noisy_support_counts_where_the_sweep_is_blocked():
    # A triangle against the lower front edge leans by 45 degrees: low, it is noise; as the foot of a wall it is not.
    def front(top):
        corners = [[0.0, -0.02, 0.0], [0.0, 0.02, 0.0], [top, 0.02, top], [top, -0.02, top]]
        return sheet(np.array(corners), flipped=True)

    low, wall = (slab_scene(front(top), noise=0.001) for top in (0.0015, 0.03))
    assert (support_contacts(replace(low, surface_noise=0.0)).normals @ low.motion).min() < -0.5
    assert (support_contacts(low).normals @ low.motion).min() >= -1e-3
    assert free_way(low).whole
    assert free_way(wall).length < 0.003
