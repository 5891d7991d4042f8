"""Starts and targets of grasps: opposed, near the centre of mass, the best of several, with tendons at rest."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from dexnudge.energies.descent import HandPose, configuration_from_pose
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.kernel_inputs import build_scene_fields
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.geometry.surface_points import SurfacePoints, surface_points
from dexnudge.synthesis.grasps import (
    NARROWEST_GRASP,
    NEAR_CENTRE,
    OPPOSING,
    WIDEST_GRASP,
    GraspConfig,
    _best_start,
    descend_to_grasp,
    opposing_pose,
    opposing_sides,
    opposing_targets,
)
from dexnudge.synthesis.object_data import TARGET_SPACING

BATCH = 8
QUICK = GraspConfig(batch=BATCH, starts=3, steps=12)


@pytest.fixture(scope="module")
def brick() -> trimesh.Trimesh:
    """Narrower than a hand opens in two directions, wider in the third; not about the origin."""
    brick = trimesh.creation.box((0.15, 0.06, 0.02))
    brick.apply_translation((0.03, -0.01, 0.05))
    return brick


@pytest.fixture(scope="module")
def surface(brick) -> SurfacePoints:
    return surface_points(brick, spacing=TARGET_SPACING)


@pytest.fixture(scope="module")
def targets(hand, brick, surface):
    return opposing_targets(hand, surface, centre_of_mass(brick), 200, np.random.default_rng(0))


@pytest.fixture(scope="module")
def fields(brick):
    return build_scene_fields(brick, None)


def normals_at(surface: SurfacePoints, places: np.ndarray) -> np.ndarray:
    """The surface's normals at targets, which are some of its points in single precision."""
    apart = np.linalg.norm(surface.points[None] - places[:, None], axis=2)
    assert apart.min(axis=1).max() < 1e-7
    return surface.normals[apart.argmin(axis=1)]


def test_thumb_and_fingers_stand_on_opposite_sides(hand, surface, targets):
    places, touches = targets.places.numpy().astype(np.float64), targets.touches.numpy() > 0
    fingers = [digit for digit in range(touches.shape[1]) if digit != hand.thumb]
    assert touches[:, hand.thumb].all()
    assert set(touches[:, fingers].sum(axis=1)) == {1, 2, 3}
    middle = np.stack([row[fingers][touch[fingers]].mean(axis=0) for row, touch in zip(places, touches, strict=True)])
    thumb_normals, finger_normals = normals_at(surface, places[:, hand.thumb]), normals_at(surface, middle)
    # The thin way through the brick is always open: every thumb finds a side that faces it.
    assert (np.einsum("ni,ni->n", thumb_normals, finger_normals) < OPPOSING).all()
    assert (np.linalg.norm(middle - places[:, hand.thumb], axis=1) < WIDEST_GRASP).all()
    # Fingers stand in a row across the line between the two sides.
    across = middle - places[:, hand.thumb]
    for row in np.flatnonzero(touches.sum(axis=1) > 2):
        line = np.ptp(places[row, fingers][touches[row, fingers]], axis=0)
        offsets = places[row, fingers][touches[row, fingers]] - middle[row]
        assert np.abs(offsets @ across[row]).max() < 1e-6 * max(1.0, np.linalg.norm(line))


def test_the_partner_is_the_straightest_that_faces(brick, surface):
    centre = centre_of_mass(brick)
    points, normals = surface.points, surface.normals
    for one, two in opposing_sides(surface, centre, 40, np.random.default_rng(1)):
        best, expected = -np.inf, -1
        for other in range(len(points)):  # a search over all pairs
            line = points[other] - points[one]
            length = np.linalg.norm(line)
            if NARROWEST_GRASP < length < WIDEST_GRASP and normals[other] @ normals[one] < OPPOSING:
                straight = -line @ normals[one] / length
                if straight > best:
                    best, expected = straight, other
        line = points[two] - points[one]
        assert -line @ normals[one] / np.linalg.norm(line) == pytest.approx(best, abs=1e-12)
        assert expected >= 0


def test_thumbs_are_drawn_about_the_centre_of_mass(brick, surface):
    centre = centre_of_mass(brick)
    first = opposing_sides(surface, centre, 4000, np.random.default_rng(2))[:, 0]
    distance = np.linalg.norm(surface.points - centre, axis=1)
    weight = np.exp(-(distance**2) / (2 * NEAR_CENTRE**2))
    weight /= weight.sum()
    expected = weight @ distance
    error = np.sqrt(weight @ (distance - expected) ** 2 / len(first))
    assert distance[first].mean() == pytest.approx(expected, abs=5 * error)
    assert distance.mean() > expected + 20 * error


@pytest.mark.parametrize(
    "mesh",
    [trimesh.creation.icosphere(subdivisions=3, radius=0.1), trimesh.creation.icosphere(subdivisions=2, radius=0.02)],
    ids=["too wide to hold", "ball"],
)
def test_a_ball_gives_finite_starts(hand, mesh):
    surface = surface_points(mesh, spacing=0.01)
    assert_finite_starts(hand, surface)


def test_a_plate_with_no_side_that_faces_gives_finite_starts(hand):
    grid = np.stack(np.meshgrid(np.linspace(-0.05, 0.05, 21), np.linspace(-0.03, 0.03, 13)), axis=-1).reshape(-1, 2)
    points = np.concatenate([grid, np.zeros((len(grid), 1))], axis=1)
    assert_finite_starts(hand, SurfacePoints(points, np.tile([0.0, 0.0, 1.0], (len(grid), 1))))


def assert_finite_starts(hand, surface: SurfacePoints) -> None:
    generator = np.random.default_rng(3)
    sides = opposing_sides(surface, surface.points.mean(axis=0), 60, generator)
    lengths = np.linalg.norm(surface.points[sides[:, 1]] - surface.points[sides[:, 0]], axis=1)
    assert ((lengths > NARROWEST_GRASP) & (lengths < WIDEST_GRASP)).all()
    targets = opposing_targets(hand, surface, surface.points.mean(axis=0), 60, generator)
    pose = opposing_pose(hand, targets, generator)
    assert targets.places.isfinite().all()
    assert pose.translation.isfinite().all()
    turned = pose.rotation @ pose.rotation.transpose(1, 2)
    torch.testing.assert_close(turned, torch.eye(3).expand_as(turned), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(torch.linalg.det(pose.rotation), torch.ones(60), atol=1e-5, rtol=0.0)


def test_starts_bring_thumb_and_fingers_onto_their_line(hand, targets):
    pose = opposing_pose(hand, targets, np.random.default_rng(4))
    tips = hand.keypoints(configuration_from_pose(pose).double()).numpy()
    places, touches = targets.places.numpy().astype(np.float64), targets.touches.numpy() > 0
    for tip, place, touch in zip(tips, places, touches, strict=True):
        fingers = touch & (np.arange(len(touch)) != hand.thumb)
        own, wanted = (there[fingers].mean(axis=0) - there[hand.thumb] for there in (tip, place))
        assert own @ wanted / np.linalg.norm(own) / np.linalg.norm(wanted) == pytest.approx(1.0, abs=1e-5)
        middle = [0.5 * (there[fingers].mean(axis=0) + there[hand.thumb]) for there in (tip, place)]
        np.testing.assert_allclose(middle[0], middle[1], atol=1e-5)


def energy_of_targets(hand, fields, targets) -> HandEnergy:
    energy = HandEnergy(hand, fields, len(targets.places), QUICK.weights)
    tips = hand.fingertip_indices
    energy.target[:, tips] = targets.places
    energy.target_weight[:, tips] = energy.contact_weight[:, tips] = targets.touches
    return energy


def test_the_start_is_for_each_hand_the_best_of_all_that_were_drawn(hand, brick, surface, fields):
    targets = opposing_targets(hand, surface, centre_of_mass(brick), BATCH, np.random.default_rng(6))
    energy = energy_of_targets(hand, fields, targets)
    generator = np.random.default_rng(7)
    drawn: list[HandPose] = [opposing_pose(hand, targets, generator) for _ in range(5)]
    totals = torch.stack([energy(pose).clone() for pose in drawn])
    best = _best_start(hand, energy, targets, 5, np.random.default_rng(7))
    torch.testing.assert_close(energy(best), totals.min(dim=0).values, rtol=1e-5, atol=1e-6)
    for item, choice in enumerate(totals.argmin(dim=0)):
        assert torch.equal(best.rotation[item], drawn[choice].rotation[item])
    assert len(set(totals.argmin(dim=0).tolist())) > 1
    single = _best_start(hand, energy, targets, 1, np.random.default_rng(7))
    assert torch.equal(single.translation, drawn[0].translation)


def test_descended_grasps_keep_tendons_limits_and_the_seed(hand, brick, surface, fields):
    runs = [
        descend_to_grasp(
            hand,
            fields,
            surface,
            centre_of_mass(brick),
            config=replace(QUICK, starts=starts),
            generator=np.random.default_rng(seed),
        )
        for seed, starts in ((8, 3), (8, 3), (9, 3))
    ]
    assert torch.equal(runs[0], runs[1])
    assert not torch.equal(runs[0], runs[2])
    angles = runs[0][:, 9:].numpy()
    follower, leader = hand.coupled_indices.T
    np.testing.assert_array_equal(angles[:, follower], angles[:, leader])
    assert (angles >= hand.lower - 1e-6).all()
    assert (angles <= hand.upper + 1e-6).all()
    assert runs[0].isfinite().all()
