"""Adam on hand poses: translation, rotation (on SO(3)) and joint angles, within limits and couplings."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.geometry.transforms import matrix_to_rotation_6d, rotation_6d_to_matrix, rotation_vector_to_matrix
from dexnudge.hands.hand import ROOT_COORDINATES, Hand


@dataclass
class HandPose:
    """A batch of hand configurations as they descend, in the working frame.

    `translation` [m] and `rotation` of the palm, `joint_angles` [rad], sliding ones [m].
    """

    translation: Float[Tensor, "batch 3"]
    rotation: Float[Tensor, "batch 3 3"]
    joint_angles: Float[Tensor, "batch joint"]


@dataclass(frozen=True)
class StepSizes:
    """Largest move of one step, per coordinate."""

    translation: float = 0.0015  # [m]
    rotation: float = 0.010  # [rad]
    joints: float = 0.020  # [rad] of `Hand.joint_scales`


FIRST_MOMENT, SECOND_MOMENT, FLOOR = 0.9, 0.98, 1.0e-10


class HandDescent:
    """Adam with one step size per kind of coordinate; every step ends inside limits and couplings.

    It descends in translation, rotation vector and joint angles over `Hand.joint_scales`: a slide moves like a finger.
    The second moment is kept per kind and sample, not per coordinate: a hand then moves along its gradient within a kind,
    and a sample never feels its neighbours.
    With `tied` both joints of each tendon turn alike (see `Hand.equalise_tendon_joints`).
    """

    def __init__(
        self, hand: Hand, batch: int, *, steps: StepSizes = StepSizes(), tied: bool = False, device: str = "cpu"
    ) -> None:
        self.hand, self.tied = hand, tied
        joints = hand.num_joints
        sizes = [steps.translation] * 3 + [steps.rotation] * 3 + [steps.joints] * joints
        self._scales = torch.tensor([1.0] * 6 + hand.joint_scales.tolist(), device=device)
        self._sizes = torch.tensor(sizes, device=device) * self._scales
        self._first = torch.zeros(batch, 6 + joints, device=device)
        self._second = torch.zeros(batch, 6 + joints, device=device)
        self._count = 0

    def step(
        self, pose: HandPose, gradient: Float[Tensor, "batch tangent"], *, scale: float | Tensor = 1.0
    ) -> HandPose:
        """Return the next pose; `scale` (a number or (batch, 1)) multiplies the step sizes, 0 holds a hand still."""
        self._count += 1
        gradient = gradient * self._scales
        self._first.lerp_(gradient, 1 - FIRST_MOMENT)
        square = torch.cat(
            [
                gradient[:, low:high].square().mean(dim=1, keepdim=True).expand(-1, high - low)
                for low, high in ((0, 3), (3, 6), (6, gradient.shape[1]))
            ],
            dim=1,
        )
        self._second.lerp_(square, 1 - SECOND_MOMENT)
        first = self._first / (1 - FIRST_MOMENT**self._count)
        second = self._second / (1 - SECOND_MOMENT**self._count)
        move = -scale * self._sizes * first / (second + FLOOR).sqrt()
        return retract(self.hand, pose, move, tied=self.tied)


def retract(hand: Hand, pose: HandPose, move: Float[Tensor, "batch tangent"], *, tied: bool = False) -> HandPose:
    """Return the pose moved along a tangent: translation added, rotation vector applied (working frame), angles clamped.

    With `tied` both joints of each tendon turn alike.
    """
    rotation = rotation_vector_to_matrix(move[:, 3:6]) @ pose.rotation
    q = torch.cat([move.new_zeros(len(move), ROOT_COORDINATES), pose.joint_angles + move[:, 6:]], dim=1)
    q = hand.equalise_tendon_joints(q) if tied else hand.clamp(q)
    return HandPose(pose.translation + move[:, :3], rotation, q[:, ROOT_COORDINATES:])


def pose_from_configuration(q: Float[Tensor, "batch coordinates"]) -> HandPose:
    """Return q = [translation | 6D rotation | joint angles] as a pose with a proper rotation."""
    return HandPose(q[:, :3].clone(), rotation_6d_to_matrix(q[:, 3:9]), q[:, ROOT_COORDINATES:].clone())


def configuration_from_pose(pose: HandPose) -> Float[Tensor, "batch coordinates"]:
    """Return q = [translation | 6D rotation | joint angles]."""
    return torch.cat([pose.translation, matrix_to_rotation_6d(pose.rotation), pose.joint_angles], dim=1)
