"""No guidance: the plain DDIM step."""

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.diffusion.ddim import ddim_step
from dexnudge.sampling.guidance.rule import ReverseStep


def unguided(step: ReverseStep) -> Float[Tensor, "batch dimension"]:
    """x_{t-1} of the prior alone."""
    with torch.inference_mode():
        x0_hat = step.prior.predict_clean(step.x_t, step.t, step.condition, guidance_scale=step.guidance_scale)
        return ddim_step(
            step.prior.schedule, step.x_t, x0_hat, step.t, step.t_previous, eta=step.eta, generator=step.generator
        ).clone()
