"""Which fingertips guidance holds to the object, those that the clean estimate brings near it, and what pulls on them."""

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.energies.descent import pose_from_configuration
from dexnudge.sampling.guidance.rule import ReverseStep

REACH_CLEAN, REACH_NOISY = 0.010, 0.030  # [m] of a fingertip from the object at the end and at the start
FORCE_SWEEPS = 20  # of the balance solver per evaluation, warm-started


def set_active_contacts(step: ReverseStep, q: Float[Tensor, "batch coordinates"]) -> None:
    """Sets the energy's contact weights, and the pull of the force balance, from the clean estimate q (frame C)."""
    energy, hand = step.energy, step.hand
    tips = hand.fingertip_indices
    energy.find_fingertip_contacts(pose_from_configuration(q))
    reach = REACH_CLEAN + (REACH_NOISY - REACH_CLEAN) * (1.0 - step.alpha_bar)
    energy.contact_weight[:, tips] = active_contacts(energy.contact_distance[:, tips], reach=reach)
    pull_to_balance(step)


def pull_to_balance(step: ReverseStep) -> Float[Tensor, " batch"] | float:
    """Has the next evaluation of the energy pull its contacts to where they balance the forces.

    Returns the term's energy, 1/2 force |residual|^2 [m^2], at the contacts of the last evaluation; 0 without it.
    """
    force, energy = step.force, step.energy
    if force is None:
        return 0.0
    tips = step.hand.fingertip_indices
    wanted = (energy.contact_weight[:, tips] > 0).float()
    force(energy.contact_point[:, tips], energy.contact_normal[:, tips], wanted, sweeps=FORCE_SWEEPS)
    energy.extra_force[:, tips] = energy.weights.force * force.gradient
    return 0.5 * energy.weights.force * force.residual.square()


def active_contacts(distance: Float[Tensor, "batch digit"], *, reach: float) -> Float[Tensor, "batch digit"]:
    """1 for the fingertips within `reach` [m] of the object, and for the nearest one in any case."""
    nearest = torch.zeros_like(distance).scatter_(1, distance.argmin(dim=1, keepdim=True), 1.0)
    return torch.maximum((distance < reach).float(), nearest)
