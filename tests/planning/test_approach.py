import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError
from dexnudge.objects.builtin import builtin_object
from dexnudge.planning.approach import Approach, ApproachPlanner
from dexnudge.planning.hand_motion import palm_pose
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.verification.penetration import PenetrationCheck

LIMIT = 1e-3  # [m] the penetration that a configuration may have


def deepest(hand, scene, q):
    T = hand.forward_kinematics(torch.as_tensor(np.asarray(q))).numpy()
    found = PenetrationCheck(hand, scene)(T, reach=0.0)
    return max(found.object.max(), found.environment.max(), found.self_collision.max())


def finer(q, parts=4):
    """Configurations between the samples; the rotation's columns are close enough to be linear there."""
    t = (np.arange(parts) / parts)[None, :, None]
    return np.concatenate([(q[:-1, None] + t * np.diff(q, axis=0)[:, None]).reshape(-1, q.shape[1]), q[-1:]])


def test_from_outside_to_contact_in_free_space(boxy_hand, block_scene, touching):
    found = ApproachPlanner(boxy_hand, block_scene).plan(touching)
    assert found.planner == "straight"
    way = found.trajectory
    np.testing.assert_allclose(way.q[-1], touching, atol=1e-9)
    np.testing.assert_allclose(way.q[0, 3:9], touching[3:9], atol=1e-9)
    before = way.times <= found.pre_contact_time + 1e-9
    np.testing.assert_allclose(way.q[before][-1, :3] - touching[:3], [0, 0, 0.02], atol=1e-9)  # along the normal
    np.testing.assert_allclose(way.duration - found.pre_contact_time, 0.02 / 0.05)
    travelled = np.linalg.norm(np.diff(way.q[before][:, :3], axis=0), axis=1).sum()
    np.testing.assert_allclose(travelled / 0.25, found.pre_contact_time)
    assert deepest(boxy_hand, block_scene, finer(way.q)) == 0


def test_a_given_start_is_where_it_begins_with_its_own_fingers(boxy_hand, window_scene, touching, at):
    start = at(0.8, 0.0, 0.3, angles=(0.5, -0.4, 0.2, 0.9))
    planner = ApproachPlanner(boxy_hand, window_scene)
    found = planner.plan(touching, start=start, seed=1)
    assert found.planner == "RRT-Connect"
    np.testing.assert_allclose(found.trajectory.q[0], start, atol=1e-9)
    np.testing.assert_allclose(found.trajectory.q[-1], touching, atol=1e-9)
    assert deepest(boxy_hand, window_scene, finer(found.trajectory.q)) == 0
    again = planner.plan(touching, start=start, seed=1)
    np.testing.assert_array_equal(found.trajectory.q, again.trajectory.q)
    np.testing.assert_array_equal(found.trajectory.times, again.trajectory.times)


def test_a_closed_cage_is_named(boxy_hand, scene_of, touching, at):
    walls = [[[-0.4, -0.4, 0.3], [0.4, 0.4, 0.32]]]
    walls += [[[x, -0.4, 0.0], [x + 0.02, 0.4, 0.3]] for x in (-0.4, 0.38)]
    walls += [[[-0.38, y, 0.0], [0.38, y + 0.02, 0.3]] for y in (-0.4, 0.38)]
    scene = scene_of([[-0.4, -0.4, -0.02], [0.4, 0.4, 0.0]], *walls)
    found = ApproachPlanner(boxy_hand, scene).plan(touching, start=at(0.0, 0.0, 0.6), budget=2000)
    assert (found.stage, found.obstacle) == ("transit", "environment")
    assert 0.29 < found.point[2] < 0.33  # the lid
    assert found.link in boxy_hand.link_names


@pytest.mark.parametrize(("lower", "obstacle", "link"), [(0.012, "object", ("tip_a", "tip_b")), (None, "hand", ("",))])
def test_a_goal_that_penetrates_is_named(boxy_hand, block_scene, touching, lower, obstacle, link):
    q = touching.copy()
    if lower is None:
        q[9:] = -0.9, -0.9, 0.9, 0.9  # the fingers cross
        q[2] += 0.1
    else:
        q[2] -= lower
    found = ApproachPlanner(boxy_hand, block_scene).plan(q)
    assert (found.stage, found.obstacle) == ("goal", obstacle)
    assert found.link in link
    assert found.clearance < -LIMIT


def test_a_hand_in_a_tight_shaft_cannot_draw_back(boxy_hand, scene_of, touching):
    around = [[[sign * 0.031, -0.2, 0.03], [sign * 0.2, 0.2, 0.3]] for sign in (-1, 1)]
    bounds = [[np.minimum(a, b), np.maximum(a, b)] for a, b in np.array(around)]
    found = ApproachPlanner(boxy_hand, scene_of([[-0.4, -0.4, -0.02], [0.4, 0.4, 0.0]], *bounds)).plan(touching)
    assert (found.stage, found.obstacle, found.link) == ("pre-contact", "environment", "palm")
    np.testing.assert_allclose(np.abs(found.point[0]), 0.031, atol=1e-6)


def test_bad_configurations_are_refused(boxy_hand, block_scene, touching):
    planner = ApproachPlanner(boxy_hand, block_scene)
    with pytest.raises(InputError, match=r"q has shape \(12,\); expected \(13,\)"):
        planner.plan(touching[:-1])
    with pytest.raises(InputError, match="start has shape"):
        planner.plan(touching, start=np.full(13, np.nan))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["table", "layers", "shelf"])
def test_sampled_configurations_are_reached_without_penetration(shadow_hand, name):
    hand, scene = shadow_hand, build_scene(name, builtin_object("phone"), seed=0)
    draws = Sampler(hand).sample(scene, num=4)
    planner = ApproachPlanner(hand, scene)
    planned = [planner.plan(np.asarray(q, dtype=float)) for q in np.asarray(draws.q)[: draws.num_verified]]
    reached = [one for one in planned if isinstance(one, Approach)]
    assert len(planned) >= 3
    assert len(reached) >= len(planned) - 1
    for one in reached:
        assert deepest(hand, scene, one.trajectory.q) <= LIMIT
        step = np.diff(one.trajectory.times)
        poses = np.array([palm_pose(q) for q in one.trajectory.q])
        turn = (Rotation.from_matrix(poses[:-1, :3, :3]).inv() * Rotation.from_matrix(poses[1:, :3, :3])).magnitude()
        assert (np.linalg.norm(np.diff(one.trajectory.q[:, :3], axis=0), axis=1) / step).max() <= 0.25 * (1 + 1e-6)
        assert (turn / step).max() <= 1.5 * (1 + 1e-6)
        assert (np.abs(np.diff(one.trajectory.q[:, 9:], axis=0)).max(axis=1) / step).max() <= 2.0 * (1 + 1e-6)
