import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.planning.clearance_kernel import point_balls
from dexnudge.planning.hand_clearance import CAP, HandClearance

LEAST_SHARE = 1 / 1.3  # of the true clearance, by the ratio at which a ball is no longer opened


def states(count, height):
    rng = np.random.default_rng(0)
    translation = rng.uniform([-0.1, -0.1, -0.02], [0.1, 0.1, height], size=(count, 3))
    return translation, Rotation.random(count, random_state=1).as_matrix(), rng.uniform(-1, 1, size=(count, 4))


def brute_force(hand, mesh, translation, rotation, angles):
    """Least distance of all dense points, one state after another."""
    q = np.concatenate([translation, rotation[:, :, 0], rotation[:, :, 1], angles], axis=1)
    T = hand.forward_kinematics(torch.as_tensor(q)).numpy()
    dense, exact = hand.dense_points, ExactDistance(mesh)
    placed = np.einsum("npij,pj->npi", T[:, dense.link][..., :3, :3], dense.points) + T[:, dense.link][..., :3, 3]
    return np.array([exact(points).distance.min() for points in placed])


@pytest.mark.parametrize("column", [0, 1])
def test_clearance_is_a_close_lower_bound_and_exact_where_something_penetrates(boxy_hand, block_scene, column):
    given = states(300, 0.25)
    found = HandClearance(boxy_hand, block_scene)(*given).distance[:, column]
    mesh = (block_scene.environment_mesh, block_scene.object_in_world())[column]
    true = brute_force(boxy_hand, mesh, *given)
    inside, capped = true <= 0, true >= CAP
    assert inside.sum() > 30
    assert (~inside & ~capped).sum() > 30
    np.testing.assert_allclose(found[inside], true[inside], atol=1e-6)
    assert (found[~inside] <= true[~inside] + 1e-6).all()
    assert (found[~inside] >= LEAST_SHARE * np.minimum(true, CAP)[~inside] - 1e-6).all()


def test_stop_tells_the_same_states_apart(boxy_hand, block_scene):
    given = states(300, 0.25)
    measure = HandClearance(boxy_hand, block_scene)
    whole, stopped = (measure(*given, stop=stop).distance.min(axis=1) for stop in (-1e3, 0.003))
    assert 0 < (whole < 0.003).sum() < 300
    np.testing.assert_array_equal(stopped < 0.003, whole < 0.003)
    assert measure.count == 600


def test_a_hand_deep_inside_a_solid_is_not_free(boxy_hand, scene_of):
    measure = HandClearance(boxy_hand, scene_of([[-1, -1, -3], [1, 1, 0]]))
    found = measure(np.array([[0.0, 0.0, -1.0]]), np.eye(3)[None], np.zeros((1, 4)))
    assert found.distance[0, 0] < -0.9


def test_nearest_link_and_place(boxy_hand, block_scene):
    measure = HandClearance(boxy_hand, block_scene)
    q = np.array([0.3, 0.0, 0.083, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.4, 0.0])
    found = measure(q[None, :3], np.eye(3)[None], q[None, 9:])
    link, place = measure.link_and_point(int(found.nearest[0, 0]), q)
    assert link == "tip_a"  # the straight finger; the other one is bent
    np.testing.assert_allclose(place[2], 0.083 - 0.073, atol=1e-6)


def test_balls_hold_what_they_contain_and_every_point_stands_alone_in_one(boxy_hand):
    points = boxy_hand.dense_points
    balls = point_balls(points)
    for index in range(len(balls.radius)):
        inner = slice(index, balls.following[index])
        assert (balls.link[inner] == balls.link[index]).all()
        gap = np.linalg.norm(balls.point[inner] - balls.point[index], axis=1)
        assert (gap <= balls.radius[index] + 1e-12).all()
    alone = balls.radius == 0
    assert {(*point, link) for point, link in zip(balls.point[alone], balls.link[alone], strict=True)} == {
        (*point, link) for point, link in zip(points.points, points.link, strict=True)
    }
