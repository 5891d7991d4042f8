"""The reverse diffusion: from noise to configurations, under a guidance rule."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.diffusion.network import Condition
from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.energies.descent import pose_from_configuration
from dexnudge.energies.terms import TermWeights
from dexnudge.errors import InputError
from dexnudge.hands.hand import Hand
from dexnudge.sampling.guidance import GuidanceRule, ReverseStep, active_contacts, unguided
from dexnudge.sampling.problem import SamplingProblem

SELECTION_SWEEPS = 60  # of the balance solver, from a cold start
SELECTION_REACH = 0.012  # [m] of a fingertip from the object to count as a contact that should be closed


@dataclass(frozen=True)
class DenoisingConfig:
    """Steps and strength of the reverse diffusion.

    Attributes:
        num_inference_steps: of DDIM. eta: 0 deterministic, 1 as much noise as DDPM.
        guidance_scale: of classifier-free guidance; 1 is the plain conditional model.
        particles: of each draw; 1 is plain denoising. With more, each draw first denoises up to that many coarse hands
            without guidance, keeps the one with the least energy in the scene, and denoises it again from `restart`,
            guided. Draws are independent.
        first_particles, good_enough: a draw begins with so many coarse hands, and makes no more once one of them has an
            energy [m^2] below `good_enough`.
        coarse_steps: DDIM steps of the coarse hands. selection_force: weight [m^2] of the squared force residual in
            choosing among them. restart: share of training steps to which the chosen one is noised.
        weights: of the energy that selects and guides.
    """

    num_inference_steps: int = 20
    eta: float = 0.0
    guidance_scale: float = 1.0
    particles: int = 1
    first_particles: int = 4
    good_enough: float = 2.0e-3
    coarse_steps: int = 4
    restart: float = 0.3
    selection_force: float = 0.01
    weights: TermWeights = TermWeights(contact=6.0)


@dataclass(frozen=True)
class _Run:
    """What all steps of one denoising share."""

    hand: Hand
    problem: SamplingProblem
    prior: DiffusionPrior
    condition: Condition
    config: DenoisingConfig
    generator: torch.Generator

    def denoise(
        self, x: Float[Tensor, "batch dimension"], timesteps: list[int], rule: GuidanceRule
    ) -> Float[Tensor, "batch dimension"]:
        """Return x_0 from x at the first of `timesteps`."""
        config = self.config
        energy = self.problem.hand_energy(self.hand, len(x), config.weights)
        shape = x.shape
        for t, t_previous in zip(timesteps, [*timesteps[1:], -1], strict=True):
            x = rule(
                ReverseStep(
                    prior=self.prior,
                    condition=self.condition,
                    hand=self.hand,
                    energy=energy,
                    x_t=x,
                    t=t,
                    t_previous=t_previous,
                    guidance_scale=config.guidance_scale,
                    eta=config.eta,
                    generator=self.generator,
                )
            )
            if not isinstance(x, Tensor) or x.shape != shape:
                found = tuple(x.shape) if isinstance(x, Tensor) else type(x).__name__
                raise InputError(f"guidance rule {rule!r} returned {found}; expected x_(t-1), a tensor {tuple(shape)}")
        if not torch.isfinite(x).all():
            raise InputError(f"guidance rule {rule!r} ended in NaN or infinity; expected finite samples")
        return x


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
    """Return `num` configurations in frame C from the prior, guided by the scene's energy; neither projected nor checked."""
    twist = problem.scene.object_motion.twist().moved(np.linalg.inv(problem.T_world_canonical))
    condition = prior.condition(problem.cloud[None], behaviour, twist=None if behaviour == "grasp" else twist)
    run = _Run(hand, problem, prior, condition, config, generator)
    timesteps = prior.schedule.timesteps(config.num_inference_steps)
    if config.particles > 1:
        timesteps = [t for t in timesteps if t <= config.restart * prior.schedule.num_train_timesteps]
        alpha_bar = float(prior.schedule.alphas_cumprod[timesteps[0]])
        noise = prior.noise(num, generator=generator)
        x = alpha_bar**0.5 * _best_coarse_hands(run, num) + (1.0 - alpha_bar) ** 0.5 * noise
    else:
        x = prior.noise(num, generator=generator)
    return hand.clamp(prior.normaliser.denormalise(run.denoise(x, timesteps, rule)))


def _best_coarse_hands(run: _Run, num: int) -> Float[Tensor, "num dimension"]:
    """Return for each draw the one of its own coarse hands with the least energy in the scene.

    A draw makes `first_particles` of them, then twice as many in all, and so on, until one is good enough or there are
    `particles`: an easy scene takes few, a hard one all.
    """
    config = run.config
    timesteps = run.prior.schedule.timesteps(config.coarse_steps)
    chosen = torch.zeros(num, run.prior.config.dimension, device=run.prior.device)
    least = torch.full((num,), torch.inf, device=run.prior.device)
    made, searching = 0, torch.arange(num, device=run.prior.device)
    while len(searching) and made < config.particles:
        count = min(max(made, config.first_particles), config.particles - made)
        x = run.prior.noise(len(searching) * count, generator=run.generator)
        x = run.denoise(x, timesteps, unguided)
        energy, best = _scene_energy(run, x).unflatten(0, (len(searching), count)).min(dim=1)
        better = energy < least[searching]
        places = searching[better]
        least[places] = energy[better]
        chosen[places] = x.unflatten(0, (len(searching), count))[better, best[better]]
        made += count
        searching = searching[least[searching] > config.good_enough]
    return chosen


def _scene_energy(run: _Run, x: Float[Tensor, "particle dimension"]) -> Float[Tensor, " particle"]:
    """Return the energy of coarse hands in the scene [m^2], their force balance included."""
    q = run.hand.equalise_tendon_joints(run.prior.normaliser.denormalise(x))
    energy = run.problem.hand_energy(run.hand, len(x), run.config.weights)
    tips = run.hand.fingertip_indices
    energy.contact_weight[:, tips] = 1.0
    pose = pose_from_configuration(q)
    energy(pose)
    energy.contact_weight[:, tips] = active_contacts(energy.contact_distance[:, tips], reach=SELECTION_REACH)
    value = energy(pose)
    if energy.force is not None:
        energy.balance_forces(sweeps=SELECTION_SWEEPS)
        value = value + run.config.selection_force * energy.force.residual.square()
    return value
