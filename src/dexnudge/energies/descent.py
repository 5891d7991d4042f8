"""Adam on hand poses: translation, rotation (on SO(3)) and joint angles, within limits and couplings."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from dexnudge.energies.descent_kernel import Moments, descend_all
from dexnudge.geometry.transforms import matrix_to_rotation_6d, rotation_6d_to_matrix
from dexnudge.geometry.warp_runtime import WarpStruct, wp
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


SLOW_DECAY = (0.9, 0.98)


class HandDescent:
    """Adam with one step size per kind of coordinate; every step ends inside limits and couplings.

    It descends in translation, rotation vector and joint angles over `Hand.joint_scales`: a slide moves like a finger.
    The second moment is kept per kind and sample, not per coordinate: a hand then moves along its gradient within a kind,
    and a sample never feels its neighbours.
    `decay` is what a step keeps of the first and of the second moment.
    With `tied` both joints of each tendon turn alike (see `Hand.equalise_tendon_joints`).

    Attributes:
        moments: a `Moments` of the kernel, for those who descend there.
    """

    moments: WarpStruct

    def __init__(
        self,
        hand: Hand,
        batch: int,
        *,
        steps: StepSizes = StepSizes(),
        decay: tuple[float, float] = SLOW_DECAY,
        tied: bool = False,
        device: str = "cpu",
    ) -> None:
        self.device, joints = device, hand.num_joints
        self._kept = torch.zeros(batch, 6 + joints, device=device), torch.zeros(batch, 3, device=device)
        self._count = torch.zeros(batch, dtype=torch.int32, device=device)
        scales = [1.0] * 6 + hand.joint_scales.tolist()
        sizes = [steps.translation] * 3 + [steps.rotation] * 3 + [steps.joints] * joints
        array = partial(wp.array, device=device)
        self.moments = moments = Moments()
        moments.first, moments.second = map(wp.from_torch, self._kept)
        moments.count = wp.from_torch(self._count)
        moments.sizes, moments.scales = array(np.multiply(sizes, scales), wp.float32), array(scales, wp.float32)
        moments.lower, moments.upper = array(hand.lower, wp.float32), array(hand.upper, wp.float32)
        moments.coupled = array(hand.coupled_indices.reshape(-1, 2), wp.int32)
        moments.tied, (moments.first_decay, moments.second_decay) = int(tied), decay

    def forget(self, rows: Int[Tensor, " row"]) -> None:
        """Begin the moments of these hands anew."""
        for kept in (*self._kept, self._count):
            kept[rows] = 0

    def step(
        self, pose: HandPose, gradient: Float[Tensor, "batch tangent"], *, scale: float | Tensor = 1.0
    ) -> HandPose:
        """Return the next pose; `scale` (a number or (batch, 1)) multiplies the step sizes, 0 holds a hand still."""
        moved = HandPose(pose.translation.clone(), pose.rotation.clone(), pose.joint_angles.clone())
        scales = (
            torch.as_tensor(scale, dtype=torch.float32, device=self.device).expand(len(gradient), 1)[:, 0].contiguous()
        )
        inputs = [
            self.moments,
            wp.from_torch(moved.translation, dtype=wp.vec3),
            wp.from_torch(moved.rotation, dtype=wp.mat33),
            wp.from_torch(moved.joint_angles),
            wp.from_torch(gradient.contiguous()),
            wp.from_torch(scales),
        ]
        wp.launch(descend_all, dim=len(gradient), inputs=inputs, device=self.device)
        return moved


def pose_from_configuration(q: Float[Tensor, "batch coordinates"]) -> HandPose:
    """Return q = [translation | 6D rotation | joint angles] as a pose with a proper rotation."""
    return HandPose(q[:, :3].clone(), rotation_6d_to_matrix(q[:, 3:9]), q[:, ROOT_COORDINATES:].clone())


def configuration_from_pose(pose: HandPose) -> Float[Tensor, "batch coordinates"]:
    """Return q = [translation | 6D rotation | joint angles]."""
    return torch.cat([pose.translation, matrix_to_rotation_6d(pose.rotation), pose.joint_angles], dim=1)
