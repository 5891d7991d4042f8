"""The residual of the force balance against SciPy's non-negative least squares, which shares no code with it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from scipy.optimize import nnls

from dexnudge.energies.force_residual import ForceResidual, SlidingBalance, support_wrenches
from dexnudge.mechanics.balance import balance_problem, solve_balance
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.sampling.problem import FRICTION_MARGIN, prepare
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.support_contacts import support_contacts
from force_balance import solve

HALF_LENGTH = 0.08  # [m]
FRICTION_HAND, FRICTION_ENVIRONMENT = 0.8, 0.4
UNBOUNDED = 1.0e4  # [weights of the object] a limit that no link reaches
SWEEPS = 4000
CONTACTS = 3
DOWN = np.asarray([0.0, 0.0, -1.0])


def corners(count: int) -> np.ndarray:
    """Corners of the underside of a block of a phone's size."""
    return np.asarray([[x, y, -0.01] for x in (-0.08, 0.08) for y in (-0.04, 0.04)])[:count]


def balance(*, supports: int = 4, max_normal: float = UNBOUNDED) -> SlidingBalance:
    """The block slides along x on its first few corners."""
    points = torch.as_tensor(corners(supports), dtype=torch.float32).reshape(-1, 3)
    forces = torch.tensor([[-FRICTION_ENVIRONMENT, 0.0, 1.0]]).repeat(supports, 1)
    return SlidingBalance(
        centre_of_mass=torch.zeros(3),
        half_length=HALF_LENGTH,
        support_wrenches=support_wrenches(points, forces, torch.zeros(3), HALF_LENGTH),
        gravity=torch.as_tensor(DOWN, dtype=torch.float32),
        friction_hand=FRICTION_HAND,
        max_normal=max_normal,
    )


def wrench(point: np.ndarray, force: np.ndarray, half_length: float = HALF_LENGTH) -> np.ndarray:
    return np.concatenate([force, np.cross(point, force) / half_length])


def hand_columns(
    points: np.ndarray, normals: np.ndarray, half_length: float = HALF_LENGTH, friction: float = FRICTION_HAND
) -> np.ndarray:
    """Edge by edge in double precision: the eight edges of each contact's pyramid."""
    found = []
    for point, normal in zip(points, normals, strict=True):
        helper = np.asarray([0.0, 1.0, 0.0]) if abs(normal[0]) > 0.7 else np.asarray([1.0, 0.0, 0.0])
        one = np.cross(normal, helper) / np.linalg.norm(np.cross(normal, helper))
        two = np.cross(normal, one)
        tangents = [np.cos(angle) * one + np.sin(angle) * two for angle in np.arange(8) * np.pi / 4]
        found += [wrench(point, -normal + friction * tangent, half_length) for tangent in tangents]
    return np.reshape(found, (-1, 6)).T


def columns(points: np.ndarray, normals: np.ndarray, supports: int) -> np.ndarray:
    """The contacts' edges and the sliding supports."""
    sliding = [wrench(point, np.asarray([-FRICTION_ENVIRONMENT, 0.0, 1.0])) for point in corners(supports)]
    return np.concatenate([hand_columns(points, normals), np.stack(sliding, axis=1)], axis=1)


def optimum(points: np.ndarray, normals: np.ndarray, supports: int) -> float:
    """Least |A lambda + g| over lambda >= 0."""
    return nnls(columns(points, normals, supports), -np.concatenate([DOWN, np.zeros(3)]))[1]


def random_contacts(batch: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points within 10 cm and unit normals; those of the second half point to one side, so that little can balance."""
    generator = np.random.default_rng(seed)
    points, normals = generator.uniform(-0.1, 0.1, (batch, CONTACTS, 3)), generator.normal(size=(batch, CONTACTS, 3))
    normals[batch // 2 :, :, 2] = np.abs(normals[batch // 2 :, :, 2]) + 1.0
    return points, normals / np.linalg.norm(normals, axis=2, keepdims=True)


def solved(points, normals, *models: SlidingBalance, active=None, sweeps: int = SWEEPS) -> ForceResidual:
    force = ForceResidual(models, torch.ones(len(points), dtype=torch.int32), points.shape[1])
    arrays = (torch.as_tensor(values, dtype=torch.float32) for values in (points, normals))
    solve(force, *arrays, active, sweeps=sweeps)
    return force


@pytest.mark.parametrize("supports", [1, 4])
def test_residual_equals_non_negative_least_squares(supports):
    points, normals = random_contacts(16, seed=supports)
    found = solved(points, normals, balance(supports=supports)).residual.numpy()
    expected = [optimum(p, n, supports) for p, n in zip(points, normals, strict=True)]
    assert max(expected) > 0.1
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_gradient_equals_finite_differences_of_the_optimum():
    points, normals = random_contacts(12, seed=5)
    force = solved(points, normals, balance(supports=1))
    step = 1.0e-5
    slopes = np.zeros_like(points)
    for place in np.ndindex(*points.shape):
        moved = []
        for sign in (1, -1):
            shifted = points[place[0]].copy()
            shifted[place[1:]] += sign * step
            moved.append(0.5 * optimum(shifted, normals[place[0]], 1) ** 2)
        slopes[place] = (moved[0] - moved[1]) / (2 * step)
    assert np.abs(slopes).max() > 0.1
    np.testing.assert_allclose(force.gradient.numpy(), slopes, atol=0.01 * np.abs(slopes).max())


def test_two_fingers_that_push_through_the_centre_balance():
    points = np.asarray([[[-0.08, -0.02, 0.0], [-0.08, 0.02, 0.0]]])
    normals = np.asarray([[[-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]])
    force = solved(points, normals, balance())
    assert float(force.residual) < 1e-3
    assert float(force.gradient.abs().max()) < 0.02


def test_without_a_hand_the_friction_is_missing():
    points, normals = random_contacts(1, seed=0)
    # The supports carry N (1 upward, 0.4 backward): the least distance to the weight leaves 0.4 / |(1, 0.4)|.
    force = solved(points, normals, balance(), active=torch.zeros(1, CONTACTS))
    assert float(force.residual) == pytest.approx(0.4 / np.hypot(1.0, 0.4), abs=0.03)
    assert optimum(np.zeros((0, 3)), np.zeros((0, 3)), 4) == pytest.approx(float(force.residual), abs=1e-3)
    assert float(force.gradient.abs().max()) == 0.0


def test_a_link_pushes_with_no_more_than_its_limit():
    below = np.asarray([[[0.0, 0.0, -0.01]]]), np.asarray([[[0.0, 0.0, -1.0]]])
    assert float(solved(*below, balance(supports=0, max_normal=2.0)).residual) == pytest.approx(0.0, abs=1e-3)
    # 0.4 of the weight leaves at least 0.6. At the limit, descent along single edges cannot exchange one edge for
    # another, so a sideways force may remain as well: the residual is then too large, never too small.
    residual = float(solved(*below, balance(supports=0, max_normal=0.4)).residual)
    sideways = 0.4 * FRICTION_HAND * np.hypot(1.0, 0.01 / HALF_LENGTH)
    assert 0.6 - 1e-4 <= residual <= np.hypot(0.6, sideways) + 1e-4


def test_hands_do_not_feel_their_neighbours():
    points, normals = random_contacts(8, seed=2)
    together = solved(points, normals, balance(), sweeps=12)
    alone = solved(points[3:4], normals[3:4], balance(), sweeps=12)
    assert torch.equal(together.residual[3:4], alone.residual)
    assert torch.equal(together.gradient[3:4], alone.gradient)


def test_few_warm_sweeps_reach_what_many_cold_ones_do():
    points, normals = random_contacts(8, seed=3)
    force = solved(points, normals, balance(), sweeps=12)
    inputs = [torch.as_tensor(array, dtype=torch.float32) for array in (points, normals)]
    for _ in range(SWEEPS // 12):
        solve(force, *inputs, sweeps=12)
    torch.testing.assert_close(force.residual, solved(points, normals, balance()).residual, atol=1e-3, rtol=0.0)


def turning_scene(*, slide: float):
    """A phone on a rough table that turns by 30 degrees in place, and then slides or does not."""
    scene = build_scene("table", "phone", seed=0)
    turn = Turn(np.pi / 6, np.array([0.0, 0.0, 1.0]), scene.object_in_world().bounds.mean(axis=0))
    return replace(scene, turn=turn, motion_length=slide, friction_environment=0.55)


def on_top_and_around(scene, batch: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Contacts on the phone's surface; world."""
    mesh = scene.object_in_world()
    generator = np.random.default_rng(seed)
    points, faces = trimesh.sample.sample_surface(mesh, batch * CONTACTS, seed=int(generator.integers(1000)))
    return np.asarray(points).reshape(batch, CONTACTS, 3), mesh.face_normals[faces].reshape(batch, CONTACTS, 3)


@pytest.mark.parametrize("slide", [0.0, 0.05])
def test_where_forces_turn_the_object_nothing_remains_and_elsewhere_something_does(slide):
    """HiGHS decides, stage by stage, at the friction that is asked for; its contacts are carried along."""
    scene = turning_scene(slide=slide)
    points, normals = on_top_and_around(scene, 24, seed=1)
    motion, feasible = scene.object_motion, np.ones(len(points), dtype=bool)
    for way in motion.beginnings:
        there, T = scene.carried(way), motion.displacement(way)
        supports, task = support_contacts(there), sliding_task(there)
        for row in range(len(points)):
            contacts = HandContacts(points=points[row], normals=normals[row], link=np.arange(CONTACTS))
            problem = balance_problem(contacts.moved(T), supports, task)
            feasible[row] &= solve_balance(problem, factor=FRICTION_MARGIN) is not None
    T_canonical_world = np.linalg.inv(prepare(scene).T_world_canonical)
    rotation, translation = T_canonical_world[:3, :3], T_canonical_world[:3, 3]
    found = solved(points @ rotation.T + translation, normals @ rotation.T, *prepare(scene).balances).residual.numpy()
    assert 4 <= feasible.sum() <= len(points) - 4
    # Forces found leave 2e-5; of those that do not exist, the nearest one, 10 % of friction short, leaves 9e-3.
    assert found[feasible].max() < 1e-3
    assert found[~feasible].min() > 1e-3


def test_the_gradient_of_a_turn_and_a_slide_equals_finite_differences_of_both():
    scene = turning_scene(slide=0.05)
    problem = prepare(scene)
    assert len(problem.balances) == 2
    T = np.linalg.inv(problem.T_world_canonical)
    points, normals = on_top_and_around(scene, 8, seed=2)
    points, normals = points @ T[:3, :3].T + T[:3, 3], normals @ T[:3, :3].T
    # Fingers so slippery that pressing never moves the object: something remains, and no force grows without end.
    unbounded = [replace(each, max_normal=UNBOUNDED, friction_hand=0.2) for each in problem.balances]
    force = solved(points, normals, *unbounded)

    def energy(points, normals):
        total = 0.0
        for each in unbounded:
            centre = each.centre_of_mass.double().numpy()
            hand = hand_columns((points - centre), normals, each.half_length, each.friction_hand)
            every = np.concatenate([hand, each.support_wrenches.double().numpy().T], axis=1)
            total += 0.5 * nnls(every, -np.concatenate([each.gravity.numpy(), np.zeros(3)]))[1] ** 2
        return total

    slopes, step = np.zeros_like(points), 1.0e-5
    for place in np.ndindex(*points.shape):
        shifted = [points[place[0]].copy() for _ in range(2)]
        for sign, moved in zip((1, -1), shifted, strict=True):
            moved[place[1:]] += sign * step
        slopes[place] = (energy(shifted[0], normals[place[0]]) - energy(shifted[1], normals[place[0]])) / (2 * step)
    assert np.abs(slopes).max() > 0.1
    np.testing.assert_allclose(force.gradient.numpy(), slopes, atol=0.02 * np.abs(slopes).max())
