"""DexGraspNet's annealed optimiser (Wang et al., ICRA 2023, and its public code): the reference for our own descent.

Each iteration proposes, for every hand, a step along the gradient scaled by the root of the mean square over the batch,
and new contacts, each drawn anew with probability 0.5; it accepts where U < exp((E - E') / T). Numbers and order are the
original's, its mean square that is 98 % the current batch's included. The rotation moves by rotation vectors instead of
six free coordinates, and joint angles stay within limits and couplings.
"""

from dataclasses import dataclass, field

import numpy as np
import torch
import trimesh
from annealed.energy import AnnealEnergy, AnnealWeights, contact_candidates
from annealed.starts import annealing_starts
from jaxtyping import Bool, Float
from moves import retract
from torch import Tensor

from dexnudge.energies.descent import HandPose, configuration_from_pose
from dexnudge.geometry.warp_runtime import WarpStruct
from dexnudge.hands.hand import Hand

FLOOR = 1.0e-6  # added to the root of the mean square


@dataclass(frozen=True)
class AnnealConfig:
    """Budget, schedules and weights: DexGraspNet's.

    `step_size` [m, rad] and `temperature` [1] shrink by `decay` every `step_period` and `temperature_period` iterations;
    `mean_square_share` is the share of the current gradient in the running mean square.
    """

    batch: int = 64
    iterations: int = 6000
    contacts: int = 4
    switch_probability: float = 0.5
    step_size: float = 0.005
    step_period: int = 50
    temperature: float = 18.0
    temperature_period: int = 30
    decay: float = 0.95
    mean_square_share: float = 0.98
    weights: AnnealWeights = field(default_factory=AnnealWeights)

    def step_size_at(self, iteration: int) -> float:
        """Step size [m, rad] of an iteration, counted from 0."""
        return self.step_size * self.decay ** (iteration // self.step_period)

    def temperature_at(self, iteration: int) -> float:
        """Temperature after an iteration, counted from 1."""
        return self.temperature * self.decay ** (iteration // self.temperature_period)


def anneal_grasps(
    hand: Hand,
    fields: WarpStruct,
    object_mesh: trimesh.Trimesh,
    centre_of_mass: Float[np.ndarray, " 3"],
    *,
    config: AnnealConfig,
    generator: np.random.Generator,
) -> Float[Tensor, "batch coordinates"]:
    """A batch of grasps q in the frame of the object's mesh, at the end of the annealing, checked by nobody yet."""
    annealer = GraspAnnealer(hand, fields, object_mesh, centre_of_mass, config=config, generator=generator)
    for _ in range(config.iterations):
        annealer.step()
    return configuration_from_pose(annealer.pose)


class GraspAnnealer:
    """A batch of hands under annealing.

    Attributes:
        pose: the current hands. energy: (batch,) of each. contact_index: (batch, contacts) candidates that touch.
        accepted: (batch,) what the last iteration did.
    """

    def __init__(
        self,
        hand: Hand,
        fields: WarpStruct,
        object_mesh: trimesh.Trimesh,
        centre_of_mass: Float[np.ndarray, " 3"],
        *,
        config: AnnealConfig,
        generator: np.random.Generator,
    ) -> None:
        self._hand, self._config, self._generator = hand, config, generator
        self._num_candidates = len(contact_candidates(hand)[0])
        self.pose = annealing_starts(hand, object_mesh, config.batch, generator)
        self.contact_index = self._draw_contacts()
        self._evaluator = AnnealEnergy(
            hand, fields, object_mesh, centre_of_mass, contact_index=self.contact_index, weights=config.weights
        )
        self.energy, self._gradient = self._evaluator.evaluate(self.pose, self.contact_index)
        self.accepted = torch.ones(config.batch, dtype=torch.bool)
        self._mean_square = torch.zeros(self._gradient.shape[1])
        self._iteration = 0

    def step(self) -> None:
        """One proposal for every hand, accepted or not."""
        config, share = self._config, self._config.mean_square_share
        self._mean_square = share * self._gradient.square().mean(dim=0) + (1 - share) * self._mean_square
        size = config.step_size_at(self._iteration)
        proposed = retract(self._hand, self.pose, -size * self._gradient / (self._mean_square.sqrt() + FLOOR))
        switched = self._generator.random(self.contact_index.shape) < config.switch_probability
        contact_index = np.where(switched, self._draw_contacts(), self.contact_index)
        self._iteration += 1
        energy, gradient = self._evaluator.evaluate(proposed, contact_index)
        uniform = torch.as_tensor(self._generator.random(config.batch), dtype=torch.float32)
        accepted = metropolis(self.energy, energy, config.temperature_at(self._iteration), uniform)
        self.pose = HandPose(
            torch.where(accepted[:, None], proposed.translation, self.pose.translation),
            torch.where(accepted[:, None, None], proposed.rotation, self.pose.rotation),
            torch.where(accepted[:, None], proposed.joint_angles, self.pose.joint_angles),
        )
        self.contact_index = np.where(accepted.numpy()[:, None], contact_index, self.contact_index)
        self.energy = torch.where(accepted, energy, self.energy)
        self._gradient = torch.where(accepted[:, None], gradient, self._gradient)
        self.accepted = accepted

    def _draw_contacts(self) -> np.ndarray:
        return self._generator.integers(self._num_candidates, size=(self._config.batch, self._config.contacts))


def metropolis(
    current: Float[Tensor, " batch"], proposed: Float[Tensor, " batch"], temperature: float, uniform: Tensor
) -> Bool[Tensor, " batch"]:
    """Where a proposal is accepted: u < exp((E - E') / T), u uniform in [0, 1)."""
    return uniform < torch.exp((current - proposed) / temperature)
