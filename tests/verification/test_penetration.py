from dataclasses import replace

import igl
import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from dexnudge.geometry.surface_lattice import surface_lattice
from dexnudge.hands.hand import Hand
from dexnudge.scenes.scene import Scene
from dexnudge.verification.penetration import PenetrationCheck, Penetrations
from dexnudge.verification.verdicts import verify, verify_in


def measure(hand: Hand, scene: Scene, q: np.ndarray) -> Penetrations:
    poses = hand.forward_kinematics(torch.as_tensor(np.atleast_2d(q))).numpy()
    return PenetrationCheck(hand, scene)(poses, reach=2e-3)


def at(upright: np.ndarray, position: list[float], **angles: float) -> np.ndarray:
    q = upright.copy()
    q[:3] = position
    for name, angle in angles.items():
        q[9 + ("one", "two", "three", "four").index(name)] = angle
    return q


@pytest.mark.parametrize("depth", [-0.003, 0.0004, 0.0035])
def test_fingertips_in_the_floor(
    boxy_hand: Hand, block_scene: Scene, upright: np.ndarray, tip_height: float, depth: float
) -> None:
    found = measure(boxy_hand, block_scene, at(upright, [0.2, 0.2, tip_height - depth]))
    assert found.environment[0] == pytest.approx(max(depth, 0.0), abs=1e-6)
    assert found.object[0] == found.self_collision[0] == 0.0


@pytest.mark.parametrize(("gap", "clearance"), [(0.0011, 0.002), (0.0031, 0.002), (-0.0007, 0.002), (0.004, 0.010)])
def test_the_surroundings_grow_by_the_clearance(
    boxy_hand: Hand, block_scene: Scene, upright: np.ndarray, tip_height: float, gap: float, clearance: float
) -> None:
    scene = replace(block_scene, clearance=clearance)
    found = measure(boxy_hand, scene, at(upright, [0.2, 0.2, tip_height + gap]))
    assert found.environment[0] == pytest.approx(max(0.0, clearance - gap), abs=1e-6)
    held = measure(boxy_hand, scene, at(upright, [0.0, 0.0, 0.02 + tip_height + 0.0005]))
    assert held.object[0] == held.environment[0] == 0.0  # the object is there to be touched


@pytest.mark.parametrize("depth", [-0.001, 0.0007, 0.003])
def test_fingertips_in_the_object(
    boxy_hand: Hand, block_scene: Scene, upright: np.ndarray, tip_height: float, depth: float
) -> None:
    found = measure(boxy_hand, block_scene, at(upright, [0.0, 0.0, 0.02 + tip_height - depth]))
    assert found.object[0] == pytest.approx(max(depth, 0.0), abs=1e-6)
    assert found.environment[0] == 0.0
    assert set(boxy_hand.dense_points.link[found.near_object.point]) == {2, 4}
    assert (found.near_object.distance <= 2e-3).all()


def test_a_spike_between_the_hands_points(boxy_hand: Hand, block_scene: Scene, upright: np.ndarray) -> None:
    """Only the surroundings' own points find a needle of 0.2 mm in the palm's face."""
    spike = trimesh.creation.cone(radius=1e-4, height=0.05)
    spike.apply_translation([0.2137, 0.2071, 0.0])
    scene = Scene(
        block_scene.object_mesh,
        trimesh.util.concatenate([block_scene.environment_mesh, spike]),
        block_scene.T_world_object,
        block_scene.motion,
    )
    found = measure(boxy_hand, scene, at(upright, [0.2, 0.2, 0.05 + 0.01 - 0.0042], one=-1, three=1))
    assert found.environment[0] == pytest.approx(0.0042, abs=1e-5)
    above = at(upright, [0.2, 0.2, 0.05 + 0.01 + 0.0008], one=-1, three=1)
    found = measure(boxy_hand, replace(scene, clearance=0.003), above)
    assert found.environment[0] == pytest.approx(0.0022, abs=1e-5)


def test_an_object_within_a_link(boxy_hand: Hand, block_scene: Scene, upright: np.ndarray) -> None:
    pea = trimesh.creation.icosphere(subdivisions=3, radius=0.004)
    pose = np.eye(4)
    pose[:3, 3] = [0.2, 0.2, 0.3]
    scene = Scene(pea, block_scene.environment_mesh, pose, block_scene.motion)
    found = measure(boxy_hand, scene, at(upright, [0.2, 0.2, 0.3]))
    assert found.object[0] == pytest.approx(0.010, abs=1e-6)  # the pea's middle is in the palm's, 10 mm from its faces


def test_fingers_in_each_other(boxy_hand: Hand, block_scene: Scene, upright: np.ndarray) -> None:
    angle = 0.4
    q = at(upright, [0.0, 0.0, 0.4], one=-angle, three=angle)
    # each finger turns inward about its own joint; by symmetry they meet in the plane x = 0
    found = measure(boxy_hand, block_scene, q)
    assert found.self_collision[0] > 1e-3
    reference = by_naive_search(boxy_hand, block_scene, q)
    assert found.self_collision[0] == pytest.approx(reference[2], abs=2e-5)


def signed(points: np.ndarray, mesh: trimesh.Trimesh) -> np.ndarray:
    """libigl's signed distance, by its exact winding number; negative inside [m]."""
    kind = igl.SIGNED_DISTANCE_TYPE_WINDING_NUMBER
    return igl.signed_distance(points, np.asarray(mesh.vertices), np.asarray(mesh.faces), sign_type=kind)[0]


def by_naive_search(hand: Hand, scene: Scene, q: np.ndarray) -> tuple[float, float, float]:
    """Depths in object, environment and itself, from all points and all meshes, with libigl."""
    poses = hand.forward_kinematics(torch.as_tensor(q[None]))[0].numpy()
    dense = hand.dense_points
    solid = [link for link, mesh in enumerate(hand.link_meshes) if len(mesh.faces)]
    cloud = {k: trimesh.transform_points(dense.points[dense.link == k], poses[k]) for k in solid}
    placed = {k: hand.link_meshes[k].copy().apply_transform(poses[k]) for k in solid}

    def depth(points: np.ndarray, mesh: trimesh.Trimesh, clearance: float = 0.0) -> float:
        low, high = mesh.bounds
        near = points[np.all((points > low - clearance) & (points < high + clearance), axis=1)]
        return max(0.0, float(clearance - signed(near, mesh).min())) if len(near) else 0.0

    results = []
    for other, kept in ((scene.object_in_world(), 0.0), (scene.environment_mesh, scene.clearance)):
        surface = surface_lattice(np.asarray(other.triangles), spacing=2e-3)[0]
        results.append(max(max(depth(cloud[k], other, kept), depth(surface, placed[k], kept)) for k in solid))
    itself = [max(depth(cloud[a], placed[b]), depth(cloud[b], placed[a])) for a, b in hand.self_collision_pairs]
    return results[0], results[1], max(itself)


def random_configurations(hand: Hand, rng: np.random.Generator, count: int) -> np.ndarray:
    """The palm near the block, turned at random, joints within their limits."""
    q = np.zeros((count, 9 + len(hand.joint_names)))
    turns = Rotation.random(count, random_state=int(rng.integers(2**31))).as_matrix()
    q[:, 3:9] = np.concatenate([turns[:, :, 0], turns[:, :, 1]], axis=1)
    q[:, 9:] = rng.uniform(hand.lower, hand.upper, (count, len(hand.lower)))
    q[:, :3] = rng.uniform([-0.08, -0.08, 0.02], [0.08, 0.08, 0.12], (count, 3))
    return q


@pytest.mark.parametrize("clearance", [0.0, 0.003])
def test_depths_equal_a_naive_search_with_libigl(boxy_hand: Hand, block_scene: Scene, clearance: float) -> None:
    scene = replace(block_scene, clearance=clearance)
    q = random_configurations(boxy_hand, np.random.default_rng(0), 12)
    found = measure(boxy_hand, scene, q)
    reference = np.array([by_naive_search(boxy_hand, scene, each) for each in q])
    assert (reference > 1e-3).any(axis=0).all()
    np.testing.assert_allclose(found.object, reference[:, 0], atol=2e-5)
    np.testing.assert_allclose(found.environment, reference[:, 1], atol=2e-5)
    np.testing.assert_allclose(found.self_collision, reference[:, 2], atol=2e-5)


@pytest.mark.slow
def test_the_shadow_hand_s_depths_equal_a_naive_search_with_libigl(block_scene: Scene) -> None:
    from dexnudge.hands.registry import load_hand

    hand = load_hand("shadow_lite")
    q = random_configurations(hand, np.random.default_rng(1), 6)
    found = measure(hand, block_scene, q)
    reference = np.array([by_naive_search(hand, block_scene, each) for each in q])
    np.testing.assert_allclose(found.object, reference[:, 0], atol=5e-5)
    np.testing.assert_allclose(found.environment, reference[:, 1], atol=5e-5)
    np.testing.assert_allclose(found.self_collision, reference[:, 2], atol=5e-5)


def test_a_batch_gives_what_its_members_give(boxy_hand: Hand, block_scene: Scene) -> None:
    q = random_configurations(boxy_hand, np.random.default_rng(2), 5)
    together = measure(boxy_hand, block_scene, q)
    for row, each in enumerate(q):
        alone = measure(boxy_hand, block_scene, each)
        assert alone.object[0] == together.object[row]
        assert alone.environment[0] == together.environment[row]
        assert alone.self_collision[0] == together.self_collision[row]
    assert len(measure(boxy_hand, block_scene, q[:0]).object) == 0


def test_several_scenes_give_what_each_gives_and_share_what_they_can(
    boxy_hand: Hand, block_scene: Scene, upright: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []
    measured = PenetrationCheck.in_environment

    def noted(check: PenetrationCheck, T_world_link: np.ndarray) -> np.ndarray:
        calls.append(check)
        return measured(check, T_world_link)

    monkeypatch.setattr(PenetrationCheck, "in_environment", noted)
    higher = np.array(block_scene.T_world_object)
    higher[2, 3] += 0.002
    raised = block_scene.environment_mesh.copy()
    raised.apply_translation([0.0, 0.0, 0.001])
    q = np.stack([at(upright, [0.2, 0.0, z], one=angle) for z in (0.07, 0.09, 0.12) for angle in (0.0, 0.6)])
    q[-1] = np.nan  # no pose
    scenes = [
        block_scene,
        replace(block_scene, T_world_object=higher),
        replace(block_scene, clearance=0.002),
        replace(block_scene, environment_mesh=raised),
    ]
    together = verify_in(scenes, boxy_hand, q)
    assert len(calls) == 3  # the second has the first one's surroundings
    for scene, found in zip(scenes, together, strict=True):
        alone = verify(scene, boxy_hand, q)
        for name, values in alone.values.items():
            np.testing.assert_array_equal(found.values[name], values)
        assert found.reasons == alone.reasons
    depths = [found.values["penetration_environment"][0] for found in together]
    assert depths[0] == depths[1] > 0
    np.testing.assert_allclose([depths[2] - depths[0], depths[3] - depths[0]], [0.002, 0.001], atol=1e-6)
    assert verify_in([], boxy_hand, q) == []
