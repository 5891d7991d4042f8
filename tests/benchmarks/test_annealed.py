"""The annealed reference against plain double loops, finite differences and closed forms."""

import numpy as np
import pytest
import torch
import trimesh
from annealed.annealing import AnnealConfig, GraspAnnealer, anneal_grasps, metropolis
from annealed.energy import (
    OBJECT_POINTS,
    POINTS_PER_SPACING,
    AnnealEnergy,
    AnnealWeights,
    contact_candidates,
    link_keypoints,
)
from annealed.starts import BACK_OFF, CONE, INFLATION, PALM_TO_FINGERS, annealing_starts
from moves import retract

from dexnudge.energies.descent import HandPose, configuration_from_pose
from dexnudge.energies.grid_kernel import pack_grids
from dexnudge.energies.kernel_inputs import build_scene_fields
from dexnudge.geometry.distance_grid import DistanceGrid
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.geometry.surface_points import surface_points
from dexnudge.objects.builtin import builtin_object

BOX = (0.07, 0.15, 0.03)  # [m]
RADIUS = 0.06  # [m] of a ball, on which distances and normals have closed forms
PADDING = 0.008  # [m] of its grid
CLEAR_OF_MIDDLE = 0.02  # [m] from the ball's middle, where a grid of 1 mm still resolves the normal
CENTRE = np.asarray([0.04, -0.03, 0.02])  # [m] about which torques are taken; beside the middle, so that they differ
BATCH = 12
OFF_MIDDLE = np.radians(25.0)  # [rad] largest angle between the object's nearest point and its middle, from a start
FORCE_CLOSURE, PENETRATION, SELF_PENETRATION, DISTANCE = range(4)


@pytest.fixture(scope="module")
def box() -> trimesh.Trimesh:
    return trimesh.creation.box(BOX)


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)


@pytest.fixture(scope="module")
def ball_fields():
    """The fields of the perfect ball, from its closed form."""
    cell, half = 0.001, RADIUS + PADDING
    axis = np.arange(-half, half + cell, cell)
    distance = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1), axis=-1) - RADIUS
    grid = DistanceGrid(distance.astype(np.float32), np.full(3, -half), cell)
    scene = build_scene_fields(trimesh.creation.box((0.01, 0.01, 0.01)), None)
    scene.grids = pack_grids([grid, grid, grid])
    return scene


@pytest.fixture(scope="module")
def fields(box):
    return build_scene_fields(box, None)


@pytest.fixture(scope="module")
def near(hand) -> HandPose:
    """Hands half closed whose fingertips are in the box or next to it."""
    generator = np.random.default_rng(3)
    q = torch.zeros(BATCH, 9 + hand.num_joints)
    q[:, 3], q[:, 7] = 1.0, 1.0
    span = hand.upper - hand.lower
    q[:, 9:] = torch.as_tensor(hand.lower + span * generator.uniform(0.2, 0.7, (BATCH, hand.num_joints)))
    q = hand.clamp(q)
    offset = torch.as_tensor(generator.uniform(-0.02, 0.02, (BATCH, 3)), dtype=torch.float32)
    rotation = torch.as_tensor(trimesh.transformations.random_rotation_matrix(generator.random(3))[:3, :3])
    rotation = rotation.float().expand(BATCH, 3, 3)
    tips = hand.keypoints(q).mean(dim=1)
    return HandPose(offset - (rotation @ tips[..., None])[..., 0], rotation.contiguous(), q[:, 9:])


@pytest.fixture(scope="module")
def contact_index(hand) -> np.ndarray:
    return np.random.default_rng(4).integers(len(contact_candidates(hand)[0]), size=(BATCH, 4))


def evaluator(hand, fields, box, contact_index, **weights: float) -> AnnealEnergy:
    return AnnealEnergy(hand, fields, box, CENTRE, contact_index=contact_index, weights=AnnealWeights(**weights))


def contact_points(hand, pose, contact_index) -> np.ndarray:
    """(batch, contact, 3) by the hand's own kinematics."""
    candidate, link = contact_candidates(hand)
    transforms = hand.forward_kinematics(configuration_from_pose(pose).double()).numpy()
    mine = transforms[np.arange(BATCH)[:, None], link[contact_index]]
    return np.einsum("bcij,bcj->bci", mine[..., :3, :3], candidate[contact_index]) + mine[..., :3, 3]


def test_contact_terms_equal_the_grasp_matrix_on_a_ball(hand, near, ball, ball_fields, contact_index):
    energy = evaluator(hand, ball_fields, ball, contact_index)
    energy(near)
    points = contact_points(hand, near, contact_index)
    within = (np.linalg.norm(points, axis=2) > CLEAR_OF_MIDDLE) & (
        np.abs(points).max(axis=2) < RADIUS + PADDING - 0.001
    )
    compared = np.flatnonzero(within.all(axis=1))
    assert len(compared) >= 3
    for item in compared:
        reach = np.linalg.norm(points[item], axis=1)
        assert float(energy.energy[item, DISTANCE]) == pytest.approx(100 * np.abs(reach - RADIUS).sum(), abs=0.15)
        grasp_matrix = np.zeros((6, 12))
        for column, (x, y, z) in enumerate(points[item] - CENTRE):
            grasp_matrix[:3, 3 * column : 3 * column + 3] = np.eye(3)
            grasp_matrix[3:, 3 * column : 3 * column + 3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        expected = float(np.square(grasp_matrix @ (points[item] / reach[:, None]).ravel()).sum())
        assert float(energy.energy[item, FORCE_CLOSURE]) == pytest.approx(expected, rel=0.02, abs=0.02)


def test_penetration_counts_each_object_point_once_for_the_deepest_link(hand, fields, box, near, contact_index):
    energy = evaluator(hand, fields, box, contact_index)
    energy(near)
    spacing = float(np.sqrt(POINTS_PER_SPACING * box.area / OBJECT_POINTS))
    points = surface_points(box, spacing=spacing).points
    assert len(points) == pytest.approx(OBJECT_POINTS, rel=0.15)
    links = [link for link, mesh in enumerate(hand.link_meshes) if len(mesh.faces)]
    exact = {link: ExactDistance(hand.link_meshes[link]) for link in links}
    transforms = hand.forward_kinematics(configuration_from_pose(near).double()).numpy()
    expected = np.zeros(BATCH)
    for item in range(BATCH):
        inside = [
            -exact[link](trimesh.transform_points(points, np.linalg.inv(transforms[item, link]))).distance
            for link in links
        ]
        expected[item] = np.maximum(np.max(inside, axis=0), 0.0).sum()
    assert expected.min() > 0.01  # [m] every hand is in the box
    # Grid cells of 1.5 and 3 mm round the edges of the links off.
    np.testing.assert_allclose(energy.energy[:, PENETRATION].numpy(), 100 * expected, rtol=0.08)


def test_self_penetration_equals_a_double_loop_over_keypoints(hand, fields, box, near, contact_index):
    energy = evaluator(hand, fields, box, contact_index)
    energy(near)
    transforms = hand.forward_kinematics(configuration_from_pose(near).double()).numpy()
    expected = np.zeros(BATCH)
    for item in range(BATCH):
        placed = [
            trimesh.transform_points(link_keypoints(hand, link), transforms[item, link])
            for link in range(len(hand.link_names))
        ]
        for one, other in hand.self_collision_pairs:
            apart = np.linalg.norm(placed[one][:, None] - placed[other][None], axis=2)
            expected[item] += 2 * np.maximum(0.02 - apart, 0.0).sum()  # a pair counts in both orders
    assert expected.max() > 0.005
    np.testing.assert_allclose(energy.energy[:, SELF_PENETRATION].numpy(), 10 * expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("term", ["distance", "penetration", "self_penetration"])
def test_gradient_equals_finite_differences(hand, fields, box, near, contact_index, term):
    weights = dict.fromkeys(("force_closure", "distance", "penetration", "self_penetration"), 0.0) | {term: 1.0}
    energy = evaluator(hand, fields, box, contact_index, **weights)
    energy(near)
    gradient = energy.gradient.clone()
    step, differences = 2e-4, torch.zeros_like(gradient)
    for coordinate in range(gradient.shape[1]):
        move = torch.zeros_like(gradient)
        move[:, coordinate] = step
        ahead = energy(retract(hand, near, move)).clone()
        differences[:, coordinate] = (ahead - energy(retract(hand, near, -move))) / (2 * step)
    # Points that enter or leave between the two ends, and cells that end there, move single entries.
    close = torch.isclose(gradient, differences, rtol=0.05, atol=0.03 * float(differences.abs().max()))
    assert float(differences.abs().max()) > 1e-3
    assert float(close.float().mean()) > 0.97


def test_metropolis_accepts_with_the_probability_of_its_rule():
    draws = 200_000
    uniform = torch.as_tensor(np.random.default_rng(0).random(draws), dtype=torch.float32)
    start = torch.full((draws,), 2.0)
    for rise, temperature in ((0.5, 1.0), (3.0, 2.0), (18.0, 18.0)):
        rate = float(metropolis(start, start + rise, temperature, uniform).float().mean())
        assert rate == pytest.approx(np.exp(-rise / temperature), abs=0.005)
    assert metropolis(start, start - 0.1, 1e-3, uniform).all()


def test_starts_stand_around_the_object_with_the_palm_towards_it(hand, box):
    pose = annealing_starts(hand, box, 48, np.random.default_rng(2))
    distance = ExactDistance(box)(pose.translation.numpy().astype(np.float64)).distance
    # The approach may lean by 30 degrees; the hull grows by 0.2 m at its vertices and by less over its faces.
    assert distance.min() > np.cos(CONE) * BACK_OFF[0]
    assert distance.max() < INFLATION + BACK_OFF[1] + 0.02
    approach = np.cos(PALM_TO_FINGERS) * hand.finger_axis + np.sin(PALM_TO_FINGERS) * hand.palm_normal
    leaning = np.einsum("bij,j,bi->b", pose.rotation.numpy(), approach, -pose.translation.numpy())
    leaning /= np.linalg.norm(pose.translation.numpy(), axis=1)
    assert leaning.min() > np.cos(CONE + OFF_MIDDLE)
    np.testing.assert_allclose(torch.linalg.det(pose.rotation).numpy(), 1.0, atol=1e-5)
    q = torch.cat([torch.zeros(48, 9), pose.joint_angles], dim=1)
    torch.testing.assert_close(hand.clamp(q), q)


def test_energy_falls_on_a_real_object(hand):
    phone = builtin_object("phone")
    phone_fields = build_scene_fields(phone, None)
    config = AnnealConfig(batch=16, iterations=300, temperature_period=3, step_period=10)
    annealer = GraspAnnealer(
        hand, phone_fields, phone, centre_of_mass(phone), config=config, generator=np.random.default_rng(0)
    )
    before = annealer.energy.clone()
    for _ in range(config.iterations):
        annealer.step()
    assert float((annealer.energy < 0.15 * before).float().mean()) == 1.0
    energy, _ = annealer._evaluator.evaluate(annealer.pose, annealer.contact_index)
    torch.testing.assert_close(energy, annealer.energy)  # what a hand keeps belongs together


def test_the_generator_alone_decides(hand, box, fields):
    config = AnnealConfig(batch=4, iterations=30)

    def run(seed: int) -> torch.Tensor:
        generator = np.random.default_rng(seed)
        return anneal_grasps(hand, fields, box, CENTRE, config=config, generator=generator)

    first = run(0)
    assert first.shape == (4, 9 + hand.num_joints)
    torch.testing.assert_close(first, run(0), rtol=0, atol=0)
    assert not torch.allclose(first, run(1))
