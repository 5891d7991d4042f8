"""Gradients of the scene's energy, in a configuration and, through the network, in the noisy sample."""

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.energies.evaluator import HandEnergy, HandPose
from dexnudge.geometry.transforms import rotation_6d_to_matrix
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.sampling.guidance.rule import ReverseStep

SMALLEST_NORM = 1.0e-12


def gradient_through_network(
    step: ReverseStep,
) -> tuple[Float[Tensor, "batch dimension"], Float[Tensor, "batch dimension"]]:
    """Return (x0_hat, g) with g = grad_{x_t} L(x0_hat(x_t)) of each sample's own energy."""
    x_t = step.x_t.detach().requires_grad_()
    x0_hat = step.predict_clean(x_t)
    q = step.prior.denormalise(x0_hat)
    step.set_active_contacts(q.detach())
    (gradient,) = torch.autograd.grad(configuration_energy(q, step.energy).sum(), x_t)
    return x0_hat.detach(), gradient


def gradient_at_clean_estimate(
    step: ReverseStep, x0_hat: Float[Tensor, "batch dimension"]
) -> tuple[Float[Tensor, " batch"], Float[Tensor, "batch dimension"]]:
    """Return (L, g) with g = grad_{x0_hat} L(x0_hat) of each sample's own energy, without the network's derivative."""
    x0 = x0_hat.detach().clone().requires_grad_()
    q = step.prior.denormalise(x0)
    step.set_active_contacts(q.detach())
    energy = configuration_energy(q, step.energy)
    (gradient,) = torch.autograd.grad(energy.sum(), x0)
    return energy.detach(), gradient


def unit(gradient: Float[Tensor, "batch dimension"]) -> Float[Tensor, "batch dimension"]:
    """Return g / |g| per sample; 0 where the energy has no slope."""
    return gradient / gradient.norm(dim=1, keepdim=True).clamp_min(SMALLEST_NORM)


def configuration_energy(q: Float[Tensor, "batch coordinates"], energy: HandEnergy) -> Float[Tensor, " batch"]:
    """Return the energy of each configuration, differentiable in q (first derivatives, from the fused kernel)."""
    rotation = rotation_6d_to_matrix(q[:, 3:9])
    angles = q[:, ROOT_COORDINATES:]
    total = _KernelEnergy.apply(q[:, :3], rotation, angles, energy)
    if energy.weights.limits > 0:
        total = total + energy.weights.limits * squared_violation(energy.hand, angles)
    return total


def squared_violation(hand: Hand, angles: Float[Tensor, "batch joint"]) -> Float[Tensor, " batch"]:
    """Return the sum of the squared violations of joint limits and couplings [rad^2]."""
    lower, upper = (
        torch.as_tensor(bound, dtype=angles.dtype, device=angles.device) for bound in (hand.lower, hand.upper)
    )
    follower, leader = hand.coupled_indices.T
    excess = torch.cat([lower - angles, angles - upper, angles[:, follower] - angles[:, leader]], dim=1)
    return excess.clamp_min(0.0).square().sum(dim=1)


class _KernelEnergy(torch.autograd.Function):
    @staticmethod
    def forward(ctx, translation, rotation, joint_angles, energy):
        value = energy(HandPose(translation, rotation, joint_angles)).clone()
        ctx.save_for_backward(energy.gradient.clone(), rotation)
        return value

    @staticmethod
    def backward(ctx, grad_output):
        gradient, rotation = ctx.saved_tensors
        gradient = gradient * grad_output[:, None]
        x, y, z = gradient[:, 3:6].unbind(dim=1)
        zero = torch.zeros_like(x)
        skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).unflatten(1, (3, 3))
        # <G, [w]x R> = torque . w for every w when G = 1/2 [torque]x R.
        return gradient[:, :3], 0.5 * skew @ rotation, gradient[:, 6:], None
