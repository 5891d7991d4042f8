"""What the denoiser is told: the object, the kind of behaviour, and the direction in which the object should move."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

CLASSES = ("grasp", "non_prehensile", "null")  # null stands where the class was dropped for classifier-free guidance
GRASP, NON_PREHENSILE, NULL_CLASS = range(3)


@dataclass(frozen=True)
class Condition:
    """One row for all samples, or one row a sample.

    object_feature: from `ConditionalDenoiser.encode`, of a cloud in frame C; behaviour: index into CLASSES;
    direction: unit vector in frame C, where planar motion is +x, zero if there is none; has_direction: whether it counts.
    """

    object_feature: Float[Tensor, "row feature"]
    behaviour: Int[Tensor, " row"]
    direction: Float[Tensor, "row 3"]
    has_direction: Bool[Tensor, " row"]

    @classmethod
    def of(
        cls,
        object_feature: Float[Tensor, "row feature"],
        behaviour: int,
        *,
        direction: tuple[float, float, float] | None,
    ) -> "Condition":
        """The same behaviour and direction for every row of `object_feature`."""
        rows, device = len(object_feature), object_feature.device
        vector = torch.tensor(direction or (0.0, 0.0, 0.0), dtype=object_feature.dtype, device=device)
        return cls(
            object_feature=object_feature,
            behaviour=torch.full((rows,), behaviour, dtype=torch.int64, device=device),
            direction=vector.expand(rows, 3),
            has_direction=torch.full((rows,), direction is not None, dtype=torch.bool, device=device),
        )

    def without_intent(self) -> "Condition":
        """The same object, with class and direction dropped: the reference of classifier-free guidance."""
        return Condition(
            object_feature=self.object_feature,
            behaviour=torch.full_like(self.behaviour, NULL_CLASS),
            direction=torch.zeros_like(self.direction),
            has_direction=torch.zeros_like(self.has_direction),
        )
