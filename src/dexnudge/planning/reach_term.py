"""Reach as an energy: palms are drawn to where the arm can bring the hand, at contact and at the end of the push."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from dexnudge.arms.arm import Arm
from dexnudge.arms.inverse_kinematics import LEVER, InverseKinematics
from dexnudge.hands.batch import HandBatch
from dexnudge.planning.object_path import check_slides, push_length
from dexnudge.planning.reach import LEAST_MARGIN, Reach
from dexnudge.scenes.scene import Scene

STARTS, STEPS = 4, 20  # of inverse kinematics: they solve 97 % of the poses that a Panda reaches
WEIGHT = 1.0  # of the term: ten times as much draws no more
ROOM = 2 * LEAST_MARGIN  # of half a joint's range that stays free: `Reach` asks for half of that
HALF_RANGE = 0.5  # of a range


class ReachTerm:
    """E = sum over contact and end of the push of min |x - x(j)|^2 + l^2 angle(R R(j)^T)^2 [m^2], over joint angles j.

    x [m] and R are where the flange must be for the hand, x(j) and R(j) where the arm brings it; l = 0.3 m. The minimum is
    found by inverse kinematics from four starts, and taken as fixed in the gradient (the envelope theorem).

    Args:
        arm: the arm, where it stands.
        mount: T_flange_mount, see `Reach`.
        weight: factor, above 0.

    Raises:
        InputError: no arm. SceneError: `mount` is no rigid pose.
    """

    name = "reach"

    def __init__(self, arm: Arm, *, mount: Any = None, weight: float = WEIGHT) -> None:
        self.weight, self._reach = weight, Reach(arm, mount=mount)
        limits = arm.limits
        room = ROOM * HALF_RANGE * (limits.upper - limits.lower)
        inner = replace(limits, lower=limits.lower + room, upper=limits.upper - room)
        self._kinematics = InverseKinematics(replace(arm, limits=inner))

    def __call__(self, hands: HandBatch, scene: Scene) -> Float[Tensor, " batch"]:
        """Return the energy of each hand."""
        check_slides(scene, "an arm whose reach is sought")
        robot = self._reach.robot(hands.hand)
        own = torch.as_tensor(np.linalg.inv(robot.T_flange_mount), dtype=hands.q.dtype, device=hands.q.device)
        flange = hands.T_world_link[:, hands.hand.link_names.index(robot.mount)] @ own
        contact = flange.detach().double().cpu().numpy()
        end = contact.copy()
        end[:, :3, 3] += push_length(scene) * scene.motion
        places, turns = self._residuals(np.concatenate([contact, end]))
        squares = (places**2).sum(axis=1) + LEVER**2 * (turns**2).sum(axis=1)
        sums = (squares.reshape(2, -1), places.reshape(2, -1, 3), turns.reshape(2, -1, 3))
        total, pull, twist = (torch.from_numpy(each.sum(axis=0)).to(hands.q) for each in sums)
        # Zero, and with the gradient of the squares while x(j) and R(j) stay.
        moved = flange[:, :3, 3] - flange[:, :3, 3].detach()
        turned = flange[:, :3, :3] @ flange[:, :3, :3].detach().transpose(1, 2)
        skew = (turned - turned.transpose(1, 2)) / 2
        angle = torch.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], dim=1)
        return total + 2 * (pull * moved).sum(dim=1) + 2 * LEVER**2 * (twist * angle).sum(dim=1)

    def _residuals(
        self, poses: Float[np.ndarray, "pose 4 4"]
    ) -> tuple[Float[np.ndarray, "pose 3"], Float[np.ndarray, "pose 3"]]:
        """Return x - x(j) [m] and the rotation vector of R R(j)^T [rad], world frame, of the best joint angles found."""
        found = self._kinematics.solve_all(
            np.repeat(poses, STARTS, axis=0),
            np.tile(self._kinematics.starts(STARTS), (len(poses), 1)),
            most_steps=STEPS,
        )
        best = found.error.reshape(-1, STARTS).argmin(axis=1) + STARTS * np.arange(len(poses))
        base = self._kinematics.arm.T_world_base
        reached = self._kinematics.chain.flange(found.positions[best])
        places = poses[:, :3, 3] - reached.position @ base[:3, :3].T - base[:3, 3]
        turns = poses[:, :3, :3] @ (base[:3, :3] @ reached.rotation).swapaxes(1, 2)
        return places, Rotation.from_matrix(turns).as_rotvec()
