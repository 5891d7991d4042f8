"""The reverse diffusion: from noise to configurations, under a guidance rule."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.diffusion.conditioning import Condition
from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.energies.descent import pose_from_configuration
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.weights import TermWeights
from dexnudge.hands.hand import Hand
from dexnudge.sampling.guidance.rule import GuidanceRule, ReverseStep
from dexnudge.sampling.guidance.unguided import unguided
from dexnudge.sampling.problem import SamplingProblem


@dataclass(frozen=True)
class DenoisingConfig:
    """Steps and strength of the reverse diffusion.

    Attributes:
        num_inference_steps: of DDIM. eta: 0 deterministic, 1 as much noise as DDPM.
        guidance_scale: of classifier-free guidance; 1 is the plain conditional model.
        particles: starts per draw; after `selection_share` of the steps, each draw goes on with the one of its own starts
            whose clean estimate has the least energy in the scene. 1 selects nothing.
        weights: of the energy that guides.
    """

    num_inference_steps: int = 20
    eta: float = 0.0
    guidance_scale: float = 1.0
    particles: int = 1
    selection_share: float = 0.5
    weights: TermWeights = TermWeights(contact=6.0)


def denoise(
    hand: Hand,
    problem: SamplingProblem,
    prior: DiffusionPrior,
    *,
    num: int,
    rule: GuidanceRule,
    behaviour: str,
    config: DenoisingConfig,
    generator: torch.Generator,
) -> Float[Tensor, "num coordinates"]:
    """`num` configurations in frame C from the prior, guided by the scene's energy; nothing is projected or checked."""
    condition = prior.condition(problem.cloud[None], behaviour, toward_motion=behaviour != "grasp")
    x = prior.noise(num * config.particles, generator=generator)
    energy = HandEnergy(hand, problem.fields, len(x), config.weights)
    timesteps = inference_timesteps(prior.schedule.num_train_timesteps, config.num_inference_steps)
    selection = int(config.selection_share * len(timesteps)) if config.particles > 1 else -1
    for index, t in enumerate(timesteps):
        if index == selection:
            x = _select(x, t, hand, prior, condition, energy, config)
            energy = HandEnergy(hand, problem.fields, num, config.weights)
        t_previous = timesteps[index + 1] if index + 1 < len(timesteps) else -1
        step = ReverseStep(
            prior, condition, hand, energy, x, t, t_previous, config.guidance_scale, config.eta, generator
        )
        x = unguided(step) if index < selection else rule(step)
    return hand.clamp(prior.denormalise(x))


def inference_timesteps(num_train_timesteps: int, num_inference_steps: int) -> list[int]:
    """Timesteps from the noisiest to the cleanest, evenly spaced, the last training step included ("trailing")."""
    steps = np.arange(num_train_timesteps, 0, -num_train_timesteps / num_inference_steps)
    return [int(round(step)) - 1 for step in steps]


def _select(
    x: Float[Tensor, "particle dimension"],
    t: int,
    hand: Hand,
    prior: DiffusionPrior,
    condition: Condition,
    energy: HandEnergy,
    config: DenoisingConfig,
) -> Float[Tensor, "num dimension"]:
    """Of each draw's particles the one with the least energy; draws never see each other."""
    with torch.inference_mode():
        q = prior.denormalise(prior.predict_clean(x, t, condition, guidance_scale=config.guidance_scale)).clone()
    value = energy(pose_from_configuration(hand.clamp(q))).unflatten(0, (-1, config.particles))
    best = value.argmin(dim=1, keepdim=True)
    grouped = x.unflatten(0, (-1, config.particles))
    return grouped.gather(1, best[..., None].expand(-1, 1, x.shape[1]))[:, 0].clone()
