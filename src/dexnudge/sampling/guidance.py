"""What a guidance rule is given and returns, and what every rule needs: the clean estimate, DDIM's step, the contacts.

A rule of one's own is any object that fits `GuidanceRule`; a package offers it as a method, see `methods`.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.diffusion.network import Condition
from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.diffusion.schedule import ddim_step
from dexnudge.energies.descent import HandPose, pose_from_configuration
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.geometry.transforms import rotation_6d_to_matrix
from dexnudge.hands.hand import ROOT_COORDINATES, Hand

REACH_CLEAN, REACH_NOISY = 0.010, 0.030  # [m] of a fingertip from the object at the end and at the start
FORCE_SWEEPS = 20  # of the balance solver per evaluation, warm-started


@dataclass(frozen=True)
class ReverseStep:
    """One step of the reverse diffusion from t to t_previous, of a batch of draws.

    Attributes:
        prior, condition: the network, and what it is asked for. hand: what is configured.
        energy: of the scene, the user's terms and the force balance included.
        x_t: normalised samples. t, t_previous: timesteps, -1 for clean data.
        guidance_scale: of classifier-free guidance. eta: DDIM's noise. generator: of every draw.
    """

    prior: DiffusionPrior
    condition: Condition
    hand: Hand
    energy: HandEnergy
    x_t: Float[Tensor, "batch dimension"]
    t: int
    t_previous: int
    guidance_scale: float
    eta: float
    generator: torch.Generator

    @property
    def alpha_bar(self) -> float:
        """Share of signal in x_t; 1 for clean data."""
        return float(self.prior.schedule.alphas_cumprod[self.t])

    def predict_clean(self, x_t: Float[Tensor, "batch dimension"]) -> Float[Tensor, "batch dimension"]:
        """Return x0_hat(x_t), differentiable in x_t."""
        return self.prior.predict_clean(x_t, self.t, self.condition, guidance_scale=self.guidance_scale)

    def clean_estimate(self) -> Float[Tensor, "batch dimension"]:
        """Return x0_hat of this step's x_t, without the network's derivative."""
        with torch.inference_mode():
            x0_hat = self.predict_clean(self.x_t)
        return x0_hat.clone()

    def ddim(self, x0_hat: Float[Tensor, "batch dimension"]) -> Float[Tensor, "batch dimension"]:
        """Return x_{t-1} of DDIM from a clean estimate, guided or not."""
        schedule = self.prior.schedule
        return ddim_step(schedule, self.x_t, x0_hat, self.t, self.t_previous, eta=self.eta, generator=self.generator)

    def set_active_contacts(self, q: Float[Tensor, "batch coordinates"]) -> None:
        """Set the energy's contact weights, and the pull of the force balance, from the clean estimate q (frame C)."""
        energy, tips = self.energy, self.hand.fingertip_indices
        energy.find_fingertip_contacts(pose_from_configuration(q))
        reach = REACH_CLEAN + (REACH_NOISY - REACH_CLEAN) * (1.0 - self.alpha_bar)
        energy.contact_weight[:, tips] = active_contacts(energy.contact_distance[:, tips], reach=reach)
        self.pull_to_balance()

    def pull_to_balance(self) -> Float[Tensor, " batch"] | float:
        """Have the next evaluation of the energy pull its contacts to where they balance the forces.

        Returns the term's energy, 1/2 force |residual|^2 [m^2], at the contacts of the last evaluation; 0 without it.
        """
        weight, force = self.energy.weights.force, self.energy.force
        if force is None or weight == 0:
            return 0.0
        self.energy.balance_forces(sweeps=FORCE_SWEEPS)
        return 0.5 * weight * force.residual.square()


def active_contacts(distance: Float[Tensor, "batch digit"], *, reach: float) -> Float[Tensor, "batch digit"]:
    """Return 1 for the fingertips within `reach` [m] of the object, and for the nearest one in any case."""
    nearest = torch.zeros_like(distance).scatter_(1, distance.argmin(dim=1, keepdim=True), 1.0)
    return torch.maximum((distance < reach).float(), nearest)


@runtime_checkable
class GuidanceRule(Protocol):
    """Turns x_t into x_{t-1} under the guidance of the energy; may keep state during the one run that it is made for."""

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """Return x at `step.t_previous`."""


def unguided(step: ReverseStep) -> Float[Tensor, "batch dimension"]:
    """Return x_{t-1} of the prior alone."""
    return step.ddim(step.clean_estimate())


SMALLEST_NORM = 1.0e-12


def gradient_through_network(
    step: ReverseStep,
) -> tuple[Float[Tensor, "batch dimension"], Float[Tensor, "batch dimension"]]:
    """Return (x0_hat, g) with g = grad_{x_t} L(x0_hat(x_t)) of each sample's own energy."""
    x_t = step.x_t.detach().requires_grad_()
    x0_hat = step.predict_clean(x_t)
    q = step.prior.normaliser.denormalise(x0_hat)
    step.set_active_contacts(q.detach())
    (gradient,) = torch.autograd.grad(configuration_energy(q, step.energy).sum(), x_t)
    return x0_hat.detach(), gradient


def gradient_at_clean_estimate(
    step: ReverseStep, x0_hat: Float[Tensor, "batch dimension"]
) -> tuple[Float[Tensor, " batch"], Float[Tensor, "batch dimension"]]:
    """Return (L, g) with g = grad_{x0_hat} L(x0_hat) of each sample's own energy, without the network's derivative."""
    x0 = x0_hat.detach().clone().requires_grad_()
    q = step.prior.normaliser.denormalise(x0)
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
    """Return the sum of the squared violations of joint limits and couplings [rad^2 of `Hand.joint_scales`]."""
    scales = hand.joint_scales
    lower, upper = (
        torch.as_tensor(bound, dtype=angles.dtype, device=angles.device)
        for bound in (hand.lower / scales, hand.upper / scales)
    )
    angles = angles / torch.as_tensor(scales, dtype=angles.dtype, device=angles.device)
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
