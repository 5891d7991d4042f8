import igl
import numpy as np
import pytest
import trimesh

from dexnudge.errors import InputError
from dexnudge.objects.builtin import builtin_object
from dexnudge.planning.object_path import GraspableLimits, NoObjectMotion, ObjectMotion, plan_object_motion
from dexnudge.scenes import build_scene

LIFT = 0.0015  # [m] steps lower than this are no obstacle


def moved(scene, pose):
    mesh = scene.object_mesh.copy()
    mesh.apply_transform(pose)
    return mesh


def assert_graspable(scene, found, limits):
    """The object's own mesh against the surroundings, by libigl and by columns of containment; nothing of ours."""
    environment = scene.environment_mesh
    vertices, faces = np.asarray(environment.vertices), np.asarray(environment.faces)
    normal = found.support_normal
    for distance in np.append(np.arange(0, found.length, 0.005), found.length):
        mesh = moved(scene, found.pose_at(distance))
        points = trimesh.sample.sample_surface(mesh, 1500, seed=0)[0] + LIFT * normal
        depth = igl.signed_distance(points, vertices, faces, sign_type=igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER)[0]
        assert depth.min() > -1e-3
        foot = mesh.center_mass - normal * ((mesh.center_mass - points) @ normal).max()  # just under the object
        foot = foot - 0.004 * normal
        assert igl.fast_winding_number(vertices, faces, foot[None])[0] > 0.5  # carried under its centre
    end = moved(scene, found.poses[-1])
    last = found.poses[-1][:3, 3] - found.poses[-2][:3, 3]
    last /= np.linalg.norm(last)
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
    np.testing.assert_array_equal(found.poses[0], scene.T_world_object)
    assert_graspable(scene, found, limits)


def block_scene(scene_of, *others, x=0.0):
    scene = scene_of([[-0.3, -0.4, -0.04], [0.3, 0.4, 0.0]], *others)
    pose = scene.T_world_object.copy()
    pose[0, 3] = x
    object.__setattr__(scene, "T_world_object", pose)
    return scene


def test_over_the_nearest_edge_by_just_enough(scene_of):
    found = plan_object_motion(block_scene(scene_of, x=0.1))
    # front at 0.18, edge at 0.30, 30 % of 0.16 m: 0.168 m in all, to the next place and point of the lattices
    np.testing.assert_allclose(found.poses[-1][:3, 3] - found.poses[0][:3, 3], [found.length, 0, 0], atol=1e-9)
    assert 0.168 <= found.length <= 0.168 + 0.0025 + 0.005
    np.testing.assert_allclose(found.balance, 0.30 - (0.1 + found.length), atol=0.006)
    assert found.room_below == pytest.approx(1.0)


def test_a_block_already_over_the_edge_stays(scene_of):
    found = plan_object_motion(block_scene(scene_of, x=0.28))
    assert found.length == 0
    assert len(found.poses) == 1
    assert 0.30 <= found.overhang <= 0.45


def test_a_post_in_the_way_turns_it_to_another_edge(scene_of):
    post = [[0.25, -0.001, 0.0], [0.252, 0.001, 0.1]]  # thinner than the distance between the object's points
    free = plan_object_motion(block_scene(scene_of, x=0.1))
    found = plan_object_motion(block_scene(scene_of, post, x=0.1))
    assert free.length < found.length
    for fraction in np.linspace(0, 1, 200):
        x, y = found.pose_at(fraction * found.length)[:2, 3]
        assert abs(x - 0.251) > 0.081 or abs(y) > 0.041


def test_a_way_of_two_pieces_where_no_straight_one_leads_out(scene_of):
    walls = [[[0.17, -0.2, 0.0], [0.19, 0.06, 0.1]], [[-0.3, 0.2, 0.0], [0.3, 0.22, 0.1]]]
    walls += [[[-0.3, -0.22, 0.0], [0.3, -0.2, 0.1]], [[-0.3, -0.2, 0.0], [-0.28, 0.2, 0.1]]]
    found = plan_object_motion(block_scene(scene_of, *walls, x=0.05))
    assert len(found.poses) == 3
    for fraction in np.linspace(0, 1, 300):
        x, y = found.pose_at(fraction * found.length)[:2, 3]
        assert x + 0.08 < 0.17 or x - 0.08 > 0.19 or y - 0.04 > 0.06  # past the first wall
        assert abs(y) + 0.04 < 0.2
    assert found.poses[-1][0, 3] + 0.08 - 0.30 >= 0.30 * 0.16


def test_room_below_is_asked_for(scene_of):
    # a second board 20 mm under the edges: a finger does not fit between
    shelf = [[-0.6, -0.7, -0.08], [0.6, 0.7, -0.015]]
    found = plan_object_motion(block_scene(scene_of, shelf, x=0.1))
    assert isinstance(found, NoObjectMotion)
    wide = plan_object_motion(block_scene(scene_of, shelf, x=0.1), GraspableLimits(room=0.012))
    np.testing.assert_allclose(wide.room_below, 0.015, atol=1e-5)


def test_a_closed_drawer_has_no_edge_and_says_so():
    found = plan_object_motion(build_scene("drawer", builtin_object("phone"), seed=0))
    assert isinstance(found, NoObjectMotion)
    assert "something is in the way (17)" in found.reason


def test_an_object_in_mid_air_is_not_moved(scene_of):
    scene = block_scene(scene_of)
    pose = scene.T_world_object.copy()
    pose[2, 3] += 0.1
    object.__setattr__(scene, "T_world_object", pose)
    assert "nothing below carries" in plan_object_motion(scene).reason


def test_bad_limits_are_refused():
    with pytest.raises(InputError, match="overhang"):
        GraspableLimits(overhang=(0.5, 0.3))
    with pytest.raises(InputError, match="room is 0"):
        GraspableLimits(room=0.0)
