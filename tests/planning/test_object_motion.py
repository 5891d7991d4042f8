import igl
import numpy as np
import pytest
import trimesh

from dexnudge.objects.builtin import builtin_object
from dexnudge.planning.lying_object import lying_object
from dexnudge.planning.object_path import GraspableLimits, ObjectMotion, plan_object_motion
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.families import build_scene

LIFT = 0.0015  # [m] steps lower than this are no obstacle


def carried(scene, found, distance):
    """The object after some of its way [m]."""
    mesh = scene.object_in_world()
    mesh.apply_translation((found.end - found.start) * distance / found.length)
    return mesh


def assert_graspable(scene, found, limits):
    """The object's own mesh against the surroundings, by libigl and by columns of containment; nothing of ours."""
    environment = scene.environment_mesh
    vertices, faces = np.asarray(environment.vertices), np.asarray(environment.faces)
    normal = lying_object(scene).normal
    for distance in np.append(np.arange(0, found.length, 0.005), found.length):
        mesh = carried(scene, found, distance)
        points = trimesh.sample.sample_surface(mesh, 1500, seed=0)[0] + LIFT * normal
        depth = igl.signed_distance(points, vertices, faces, sign_type=igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER)[0]
        assert depth.min() > -1e-3
        foot = mesh.center_mass - normal * ((mesh.center_mass - points) @ normal).max()  # just under the object
        foot = foot - 0.004 * normal
        assert igl.fast_winding_number(vertices, faces, foot[None])[0] > 0.5  # carried under its centre
    end = carried(scene, found, found.length)
    last = (found.end - found.start) / found.length
    along = end.vertices @ last
    grid = trimesh.sample.sample_surface(end, 4000, seed=1)[0]
    free = grid[grid @ last > along.max() - found.free_length + 0.001]
    below = (free - (free @ normal - (end.vertices @ normal).min())[:, None] * normal)[:, None] - (
        np.linspace(0.002, limits.room - 0.001, 9)[:, None] * normal
    )
    above = free[:, None] + np.linspace(0.012, limits.room - 0.001, 5)[:, None] * normal
    for column in (below, above):
        assert igl.fast_winding_number(vertices, faces, column.reshape(-1, 3)).max() < 0.5
    np.testing.assert_allclose(found.overhang, found.free_length / np.ptp(along), rtol=0.02)
    assert limits.overhang[0] <= found.overhang <= limits.overhang[1]


@pytest.mark.parametrize("name", ["table", "layers", "shelf", "slot", "deep", "ramp", "clutter"])
def test_the_object_gets_over_an_edge_without_tipping_or_hitting_anything(name):
    scene = build_scene(name, builtin_object("phone"), seed=1)
    limits = GraspableLimits()
    found = plan_object_motion(scene, limits)
    assert isinstance(found, ObjectMotion)
    np.testing.assert_array_equal(found.start, scene.T_world_object[:3, 3])
    assert_graspable(scene, found, limits)


def block_scene(scene_of, *others, x=0.0):
    scene = scene_of([[-0.3, -0.4, -0.04], [0.3, 0.4, 0.0]], *others)
    pose = scene.T_world_object.copy()
    pose[0, 3] = x
    object.__setattr__(scene, "T_world_object", pose)
    return scene


def room_below(scene, found):
    """Least way down from the free part at the end [m]."""
    lying, along = lying_object(scene), (found.end - found.start) / found.length
    free = lying.lower @ along > (lying.points @ along).max() - found.free_length
    return lying.below(found.end - found.start)[free].min()


def test_over_the_nearest_edge_by_just_enough(scene_of):
    scene = block_scene(scene_of, x=0.1)
    found = plan_object_motion(scene)
    # front at 0.18, edge at 0.30, 30 % of 0.16 m: 0.168 m in all, to the next place and point of the lattices
    np.testing.assert_allclose(found.end - found.start, [found.length, 0, 0], atol=1e-9)
    assert 0.168 <= found.length <= 0.168 + 0.0025 + 0.005
    balance = lying_object(scene).at_rest(found.end - found.start, least=0.004).margin
    np.testing.assert_allclose(balance, 0.30 - (0.1 + found.length), atol=0.006)
    assert room_below(scene, found) == pytest.approx(1.0)


def test_a_block_already_over_the_edge_stays(scene_of):
    found = plan_object_motion(block_scene(scene_of, x=0.28))
    assert found.length == 0
    assert 0.30 <= found.overhang <= 0.45


def test_a_thin_post_in_the_way_is_seen(scene_of):
    post = [[0.25, -0.001, 0.0], [0.252, 0.001, 0.1]]  # thinner than the distance between the object's points
    assert plan_object_motion(block_scene(scene_of, post, x=0.1)) is Outcome.OBSTRUCTED


@pytest.mark.parametrize(
    ("x", "overhang", "outcome"),
    [(0.1, (0.6, 0.9), Outcome.WOULD_TIP), (0.294, (0.3, 0.45), Outcome.WOULD_OVERHANG)],
)
def test_an_object_that_would_tip_or_is_too_far_out_is_not_graspable(scene_of, x, overhang, outcome):
    # It tips from half of its 160 mm; at x = 0.294 m it hangs over by 46 %.
    assert plan_object_motion(block_scene(scene_of, x=x), GraspableLimits(overhang=overhang)) is outcome


def test_room_below_is_asked_for(scene_of):
    # a second board 20 mm under the edges: a finger does not fit between
    shelf = [[-0.6, -0.7, -0.08], [0.6, 0.7, -0.015]]
    found = plan_object_motion(block_scene(scene_of, shelf, x=0.1))
    assert found is Outcome.WOULD_TIP
    scene = block_scene(scene_of, shelf, x=0.1)
    wide = plan_object_motion(scene, GraspableLimits(room=0.012))
    np.testing.assert_allclose(room_below(scene, wide), 0.015, atol=1e-5)


def test_a_closed_drawer_is_seen():
    found = plan_object_motion(build_scene("drawer", builtin_object("phone"), seed=0))
    assert found is Outcome.OBSTRUCTED


def test_an_object_in_mid_air_is_not_moved(scene_of):
    scene = block_scene(scene_of)
    pose = scene.T_world_object.copy()
    pose[2, 3] += 0.1
    object.__setattr__(scene, "T_world_object", pose)
    assert plan_object_motion(scene) is Outcome.UNSUPPORTED
