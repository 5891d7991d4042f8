"""What grasps are asked to hold: opposing digits can, digits that only carry from below cannot."""

import numpy as np
import pytest
import torch
from scipy.optimize import nnls

from dexnudge.energies.force_residual import ForceResidual
from dexnudge.execution.grasp_and_lift import NARROWED, holding_balance
from dexnudge.objects.builtin import builtin_object
from dexnudge.sampling.problem import prepare
from dexnudge.scenes.families import build_scene
from force_balance import solve


@pytest.fixture(scope="module")
def balance():
    return holding_balance(prepare(build_scene("table", builtin_object("phone"), seed=0)))


def residual(balance, points: np.ndarray, normals: np.ndarray) -> float:
    """Of three contacts; normals point out of the object."""
    force = ForceResidual((balance,), torch.ones(1, dtype=torch.int32), len(points))
    arrays = [torch.as_tensor(values[None], dtype=torch.float32) for values in (points, normals)]
    solve(force, *arrays, sweeps=4000)
    return float(force.residual[0])


def reference(balance, points: np.ndarray, normals: np.ndarray) -> float:
    """The same by SciPy, with cones of 64 edges."""
    columns = []
    for point, normal in zip(points, normals, strict=True):
        one = np.cross(normal, [1.0, 0.0, 0.0])
        one /= np.linalg.norm(one)
        two = np.cross(normal, one)
        for angle in np.linspace(0.0, 2 * np.pi, 64, endpoint=False):
            force = -normal + balance.friction_hand * (np.cos(angle) * one + np.sin(angle) * two)
            arm = (point - balance.centre_of_mass.numpy()) / balance.half_length
            columns.append(np.concatenate([force, np.cross(arm, force)]))
    gravity = np.concatenate([balance.gravity.numpy(), np.zeros(3)])
    return float(nnls(np.array(columns).T, -gravity)[1])


def test_opposing_digits_hold_and_carrying_ones_do_not(balance):
    centre = balance.centre_of_mass.numpy()
    places = centre + np.array([[0.0, -0.02, -0.005], [0.01, 0.01, -0.005], [-0.01, 0.01, -0.005]])
    down, up = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])
    carrying = residual(balance, places, np.array([down, down, down]))
    # The closest that forces inside cones of 0.48 come to a weight tilted by 60 degrees: sin(60 deg - atan 0.48), at least.
    assert carrying >= np.sin(np.radians(60.0) - np.arctan(NARROWED * 0.8)) - 0.02
    aside = centre + np.array([[0.0, -0.02, 0.005], [0.01, 0.01, -0.005], [-0.01, 0.01, -0.005]])
    assert residual(balance, aside, np.array([up, down, down])) == pytest.approx(
        reference(balance, aside, np.array([up, down, down])), abs=0.05
    )
    opposite = aside + np.array([[0.0, 0.03, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert residual(balance, opposite, np.array([up, down, down])) < 0.01
    assert reference(balance, opposite, np.array([up, down, down])) < 0.01
    assert float(balance.gravity.norm()) == pytest.approx(1.0)
