"""Non-prehensile configurations by Eq. 1: reach for points of the object's surface, then touch it, without penetration."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.energies import HandEnergy
from dexnudge.energies.descent import HandDescent, StepSizes, configuration_from_pose
from dexnudge.energies.weights import TermWeights
from dexnudge.geometry.surface_points import SurfacePoints
from dexnudge.geometry.warp_runtime import WarpStruct
from dexnudge.hands.hand import Hand
from dexnudge.synthesis.start_poses import sample_pre_contact


@dataclass(frozen=True)
class NonPrehensileConfig:
    """Budget and weights of Eq. 1's descent.

    The first `reach_steps` follow both terms of Eq. 1, the others only the touch; step sizes shrink to `final_scale`.
    """

    batch: int = 256
    reach_steps: int = 50
    touch_steps: int = 110
    final_scale: float = 0.05
    steps: StepSizes = StepSizes(translation=0.003, rotation=0.03, joints=0.05)
    weights: TermWeights = TermWeights(
        environment=4.0, object=4.0, self=4.0, contact=8.0, target=1.0, clearance_object=0.0005, contact_gap=0.0007
    )


def descend_to_contact(
    hand: Hand,
    fields: WarpStruct,
    surface: SurfacePoints,
    centre_of_mass: Float[np.ndarray, " 3"],
    *,
    config: NonPrehensileConfig,
    generator: np.random.Generator,
) -> tuple[Float[Tensor, "batch coordinates"], list[str]]:
    """(q, intents): configurations in the resting frame at the end of the descent, checked by nobody yet.

    An intent is what its start was meant to be: push, press or hook.
    """
    start = sample_pre_contact(hand, surface, centre_of_mass, count=config.batch, generator=generator)
    energy = HandEnergy(hand, fields, config.batch, config.weights)
    tips = hand.fingertip_indices
    touches = torch.as_tensor(start.touches, dtype=torch.float32)
    energy.target[:, tips] = torch.as_tensor(start.target, dtype=torch.float32)
    energy.target_weight[:, tips] = touches
    energy.contact_weight[:, tips] = touches
    descent = HandDescent(hand, config.batch, steps=config.steps)
    pose, total = start.pose, config.reach_steps + config.touch_steps
    for step in range(total):
        if step == config.reach_steps:
            energy.set_weights(replace(config.weights, target=0.0))
        energy(pose)
        pose = descent.step(pose, energy.gradient, scale=config.final_scale ** (step / total))
    return configuration_from_pose(pose), start.intents
