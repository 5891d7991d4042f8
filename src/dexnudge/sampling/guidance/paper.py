"""The paper's rule, Eq. 5 as printed: x_{t-1} = DDIM(x_t) - s * g / |g|,  g = grad_{x_t} L(x0_hat(x_t)).

The gradient runs through the network. It is normalised per sample, so it pushes with full strength even where almost
nothing is wrong; with a deterministic sampler it is a heuristic, not the spherical-Gaussian guidance that it cites.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.diffusion.ddim import ddim_step
from dexnudge.energies.evaluator import HandEnergy, HandPose
from dexnudge.geometry.rotations import rotation_6d_to_matrix
from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.sampling.guidance.contacts import set_wanted_contacts
from dexnudge.sampling.guidance.rule import ReverseStep

SMALLEST_NORM = 1.0e-12


@dataclass(frozen=True)
class PaperGuidance:
    """Eq. 5 with strength s in the normalised space of x."""

    strength: float = 0.05

    def __call__(self, step: ReverseStep) -> Float[Tensor, "batch dimension"]:
        """x_{t-1}, each sample guided by its own gradient's direction."""
        x_t = step.x_t.detach().requires_grad_()
        x0_hat = step.prior.predict_clean(x_t, step.t, step.condition, guidance_scale=step.guidance_scale)
        q = step.prior.denormalise(x0_hat)
        set_wanted_contacts(step, q.detach())
        loss = configuration_energy(q, step.energy)
        (gradient,) = torch.autograd.grad(loss.sum(), x_t)
        unit = gradient / gradient.norm(dim=1, keepdim=True).clamp_min(SMALLEST_NORM)
        plain = ddim_step(
            step.prior.schedule,
            step.x_t,
            x0_hat.detach(),
            step.t,
            step.t_previous,
            eta=step.eta,
            generator=step.generator,
        )
        return plain - self.strength * unit


def configuration_energy(q: Float[Tensor, "batch coordinates"], energy: HandEnergy) -> Float[Tensor, " batch"]:
    """Energy of each configuration, differentiable in q (first derivatives, from the fused kernel)."""
    rotation = rotation_6d_to_matrix(q[:, 3:9])
    return _KernelEnergy.apply(q[:, :3], rotation, q[:, ROOT_COORDINATES:], energy)


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
