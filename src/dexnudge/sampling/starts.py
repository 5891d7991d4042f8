"""Starts that need no model: stored hands of the most similar training object. Their dataset is read with pyarrow."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dexnudge.dataset.loading import load_dataset, turn_configurations, turn_vectors
from dexnudge.dataset.schema import BEHAVIOURS, NUM_DIRECTIONS, direction_angles
from dexnudge.errors import DatasetError
from dexnudge.hands.hand import Hand

FEASIBLE_MARGIN = 1.0  # force margin from which a stored configuration can move its object; as in verification
SAME = 9  # decimals of the sum of squares [m^2] that count: (0.03 mm)^2
GRASP = BEHAVIOURS.index("grasp")


@dataclass(frozen=True)
class TrainingPoses:
    """The pushes, presses and hooks of a dataset, in the resting frames of their objects.

    q: (row, 9 + d) [m, rad]. object_index: of each row, into `clouds`. feasible: whether a row can move its object along
    direction k. clouds: surface points of each object [m].
    """

    q: Float[Tensor, "row coordinates"]
    object_index: Int[np.ndarray, " row"]
    feasible: Bool[np.ndarray, "row direction"]
    clouds: Float[Tensor, "object point 3"]

    @classmethod
    def load(cls, folder: Path | str, hand: Hand) -> "TrainingPoses":
        """Load those in a dataset folder that was generated for this hand.

        Raises:
            DatasetError: no dataset, a damaged one, one for another hand, or one without a feasible configuration.
        """
        dataset = load_dataset(folder)
        theirs = (dataset.manifest.hand, dataset.manifest.joint_names)
        if theirs != (hand.name, hand.joint_names):
            raise DatasetError(
                f"{folder} holds poses of hand '{theirs[0]}' with {len(theirs[1])} joints; expected '{hand.name}' with "
                f"{hand.num_joints}; pass a dataset that `dexnudge dataset generate --hand {hand.name}` made"
            )
        feasible = dataset.direction_margin >= FEASIBLE_MARGIN
        kept = (dataset.behaviour != GRASP) & feasible.any(axis=1)
        if not kept.any():
            raise DatasetError(
                f"{folder} holds no push, press or hook that can move its object; expected at least one; "
                "generate more with `dexnudge dataset generate --non-prehensile N`"
            )
        clouds = torch.from_numpy(dataset.clouds[..., :3])
        return cls(torch.from_numpy(dataset.q[kept]), dataset.object_index[kept], feasible[kept], clouds)

    def nearest(self, cloud: Float[Tensor, "point 3"]) -> tuple[int, int]:
        """Return (object, direction k) whose reach differs least from that of `cloud` (frame C) and that has a feasible row.

        The reach of an object is max_p p · u over its points, for u up, and for 16 planar directions u counted from the
        motion; so like objects are meant that also lie alike to the motion. Least: sum of squares; of equals the first.
        """
        usable = np.zeros((len(self.clouds), NUM_DIRECTIONS), dtype=bool)
        np.logical_or.at(usable, self.object_index, self.feasible)
        planar, up = _reach(self.clouds)
        own_planar, own_up = _reach(cloud[None])
        difference = np.full(usable.shape, np.inf)
        for k in range(NUM_DIRECTIONS):
            # Direction j of frame C is direction j + k of the resting frame.
            turned = np.roll(planar, -k, axis=1)
            difference[:, k] = ((turned - own_planar) ** 2).sum(axis=1) + (up - own_up) ** 2
        # Most slabs look the same from both ends: rounding alone must not choose between the two.
        index = int(np.argmin(np.where(usable, difference.round(SAME), np.inf)))
        return index // NUM_DIRECTIONS, index % NUM_DIRECTIONS


def nearest_pose_start(
    poses: TrainingPoses, cloud: Float[Tensor, "point 6"], *, count: int, generator: torch.Generator
) -> Float[Tensor, "count coordinates"]:
    """Return `count` stored hands of the nearest training object (frame C), their positions stretched to this one.

    cloud: points [m] and normals of the object, frame C, in which the motion is +x. Only hands that can move their own
    object along the same direction are taken, at random, none twice before all were taken once. The palm's position is
    multiplied, axis by axis, by the ratio of the two objects' extents in frame C; rotation and joint angles stay.
    """
    nearest, k = poses.nearest(cloud[:, :3])
    yaw = torch.tensor(-direction_angles()[k], dtype=torch.float32, device="cpu")
    rows = np.flatnonzero((poses.object_index == nearest) & poses.feasible[:, k])
    order = torch.randperm(len(rows), generator=generator, device="cpu").numpy()
    q = turn_configurations(poses.q[rows[np.resize(order, count)]], yaw)
    ratio = _extents(cloud[:, :3]) / _extents(turn_vectors(poses.clouds[nearest], yaw))
    return torch.cat([q[:, :3] * ratio, q[:, 3:]], dim=1)


def _reach(
    clouds: Float[Tensor, "object point 3"],
) -> tuple[Float[np.ndarray, "object 16"], Float[np.ndarray, " object"]]:
    """(along the 16 planar directions, upwards) [m]."""
    angles = torch.as_tensor(direction_angles(), dtype=clouds.dtype, device=clouds.device)
    directions = torch.stack([torch.cos(angles), torch.sin(angles)])
    return (clouds[..., :2] @ directions).amax(dim=1).numpy(), clouds[..., 2].amax(dim=1).numpy()


def _extents(points: Float[Tensor, "point 3"]) -> Float[Tensor, " 3"]:
    return points.amax(dim=0) - points.amin(dim=0)
