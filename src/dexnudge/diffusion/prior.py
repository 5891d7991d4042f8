"""The learned prior as a sampler sees it: clean estimates, and the way between x and q."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.diffusion.checkpoint import load_model
from dexnudge.diffusion.config import ModelConfig
from dexnudge.diffusion.network import CLASSES, NULL_CLASS, Condition, ConditionalDenoiser, Normaliser
from dexnudge.diffusion.schedule import NoiseSchedule
from dexnudge.errors import CheckpointError, UnknownNameError
from dexnudge.hands.hand import Hand
from dexnudge.scenes.motion import Twist

SLIDE = Twist(np.array([1.0, 0.0, 0.0]), np.zeros(3))  # frame C is turned so that a slide is +x


class DiffusionPrior:
    """Network, normaliser and noise schedule of one hand. x is normalised; q is in frame C [m, rad]."""

    def __init__(self, network: ConditionalDenoiser, normaliser: Normaliser) -> None:
        self.network = network
        self.normaliser = normaliser
        self.schedule = NoiseSchedule(network.config.architecture)

    @classmethod
    def from_folder(
        cls, folder: Path | str, hand: Hand | None = None, *, device: torch.device | str = "cpu"
    ) -> "DiffusionPrior":
        """Load a model folder; raises CheckpointError for a bad folder or a model of another hand."""
        network, normaliser = load_model(folder)
        if hand is not None and tuple(hand.joint_names) != network.config.joint_names:
            raise CheckpointError(
                f"{folder} was trained for hand {network.config.hand!r} with joints "
                f"{', '.join(network.config.joint_names)}, but hand {hand.name!r} has joints "
                f"{', '.join(hand.joint_names)}; train a model for this hand with `dexnudge train`."
            )
        return cls(network.to(device), normaliser.to(device))

    @property
    def config(self) -> ModelConfig:
        """Hand and shape of the model."""
        return self.network.config

    @property
    def device(self) -> torch.device:
        """Where the weights lie."""
        return self.normaliser.mean.device

    def condition(
        self, points: Float[Tensor, "object point 6"], behaviour: str = "non_prehensile", *, twist: Twist | None = SLIDE
    ) -> Condition:
        """Return one condition row per object.

        points: surface points [m] and outward normals in frame C; behaviour: one of `CLASSES`; twist: in frame C, with
        which the object should begin to move, a slide always along +x; without one frame C may have any yaw. Of weights
        that were only trained on slides a turn asks for no motion in particular.
        """
        if behaviour not in CLASSES:
            raise UnknownNameError(f"unknown behaviour class {behaviour!r}; expected one of {', '.join(CLASSES)}.")
        feature = self.network.encode(points.to(self.device, torch.float32))
        if twist is not None and not twist.angular.any():
            twist = SLIDE
        elif not self.network.turn_embedding.any():
            twist = None
        rows, numbers = len(feature), np.zeros(6) if twist is None else np.concatenate([twist.linear, twist.angular])
        return Condition(
            object_feature=feature,
            behaviour=torch.full((rows,), CLASSES.index(behaviour), device=self.device),
            twist=feature.new_tensor(numbers).expand(rows, 6),
            has_twist=torch.full((rows,), twist is not None, device=self.device),
        )

    def noise(self, num: int, *, generator: torch.Generator | None = None) -> Float[Tensor, "num dimension"]:
        """Return x_T, where sampling starts."""
        return torch.randn(num, self.config.dimension, generator=generator, device="cpu").to(self.device)

    def predict_clean(
        self, x_t: Float[Tensor, "batch dimension"], t: int, condition: Condition, *, guidance_scale: float = 1.0
    ) -> Float[Tensor, "batch dimension"]:
        """Return the estimate of x_0 from x_t; differentiable with respect to x_t.

        condition: one row for all samples or one a sample. guidance_scale w (classifier-free guidance, Ho and Salimans,
        2022): x_0 = x_0(nothing) + w (x_0(condition) - x_0(nothing)); 1 is the plain conditional estimate, 0 knows only
        the object. Costs two network passes for every w except 0 and 1.
        """
        unconditional = condition.without_intent()
        if guidance_scale == 0.0:
            estimate = self._estimate(x_t, t, unconditional)
        elif guidance_scale == 1.0 or bool((condition.behaviour == NULL_CLASS).all() & ~condition.has_twist.any()):
            estimate = self._estimate(x_t, t, condition)
        else:
            estimate = torch.lerp(
                self._estimate(x_t, t, unconditional), self._estimate(x_t, t, condition), guidance_scale
            )
        limit = self.config.architecture.clean_limit
        return estimate.clamp(-limit, limit)

    def _estimate(
        self, x_t: Float[Tensor, "batch dimension"], t: int, condition: Condition
    ) -> Float[Tensor, "batch dimension"]:
        rows = len(condition.behaviour)
        timestep = torch.full((rows,), t, dtype=torch.int64, device=x_t.device)
        return self.schedule.clean_estimate(self.network(x_t, timestep, *condition.inputs), x_t, timestep)
