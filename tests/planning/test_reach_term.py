"""The energy of reach: zero within a SCARA's annulus, the squared distance outside, its gradient, and where it leads."""

import numpy as np
import pytest
import torch

import dexnudge as dn
from dexnudge.energies.terms import TermEnergy, check_terms
from dexnudge.planning.object_path import push_length
from dexnudge.planning.reach_term import ReachTerm

STRETCHED = 0.8  # [m] of the palm from the base, its x-axis straight away from it


@pytest.fixture
def term(scara):
    return ReachTerm(scara, mount=np.eye(4))


def q_at(hand, *places):
    """Palms at places, unturned."""
    q = torch.zeros(len(places), 9 + hand.num_joints, dtype=torch.float64)
    q[:, :3] = torch.as_tensor(places, dtype=torch.float64)
    q[:, 3] = q[:, 7] = 1.0
    return q


def test_the_energy_is_zero_within_reach_and_the_squared_distances_outside(term, boxy_hand, block_scene):
    """Straight ahead, the hand lacks what its place exceeds 0.8 m by, at contact and at the end; and turning is no help.

    The lift ends at 0.5 m, 2 % of which the term leaves free."""
    length, beyond = push_length(block_scene), 0.1
    q = q_at(boxy_hand, (0.5, 0.0, 0.1), (STRETCHED + beyond, 0.0, 0.1), (0.4, 0.0, 0.5 + beyond))
    energy = term(dn.HandBatch(boxy_hand, q.requires_grad_()), block_scene).detach()
    lift = 0.5 * (1 - 0.04)
    expected = [0.0, beyond**2 + (beyond + length) ** 2, 2 * (0.5 + beyond - lift) ** 2]
    np.testing.assert_allclose(energy, expected, rtol=0.02, atol=1e-8)


def test_the_gradient_equals_finite_differences(term, boxy_hand, block_scene):
    turned = q_at(boxy_hand, (0.9, 0.2, 0.1), (0.3, 0.1, 0.55), (0.85, -0.1, 0.1))
    turned[1, 3:9] = torch.tensor([1.0, 0.0, 0.0, 0.0, np.cos(0.3), np.sin(0.3)])

    def energy(q):
        return term(dn.HandBatch(boxy_hand, q), block_scene)

    leaf = turned.clone().requires_grad_()
    gradient = torch.autograd.grad(energy(leaf).sum(), leaf)[0]
    step = 1e-4
    near = 0.05 * float(gradient.abs().max())  # inverse kinematics stops within some percent of the minimum
    for column in range(3):
        shift = torch.zeros_like(turned)
        shift[:, column] = step
        slope = (energy(turned + shift) - energy(turned - shift)) / (2 * step)
        np.testing.assert_allclose(gradient[:, column], slope, atol=near)
    assert float(gradient[1, 3:9].abs().max()) > 0.01  # the tilted hand is turned back


def test_it_leads_an_unreachable_palm_to_where_the_arm_reaches(term, scara, boxy_hand, block_scene):
    q = q_at(boxy_hand, (0.95, 0.1, 0.1))
    for _ in range(30):
        leaf = q.clone().requires_grad_()
        energy = term(dn.HandBatch(boxy_hand, leaf), block_scene)
        q = q - 0.2 * torch.autograd.grad(energy.sum(), leaf)[0]
    assert float(energy.detach()) < 1e-6
    assert dn.Reach(scara, mount=np.eye(4))(dn.HandBatch(boxy_hand, q, dense=True), block_scene).value[0] > 0


def test_it_is_a_term_that_the_sampler_takes(term, boxy_hand, block_scene):
    from dexnudge.energies.descent import pose_from_configuration

    assert check_terms([term]) == (term,)
    q = q_at(boxy_hand, (0.5, 0.0, 0.1), (0.9, 0.0, 0.1)).float()
    energy, slope = TermEnergy([term], boxy_hand, block_scene, np.eye(4))(pose_from_configuration(q))
    assert energy[0] < 1e-8
    assert slope[1, 0] > 0.1
    assert torch.isfinite(slope).all()
