"""Training batches: groups of configurations of one object that share a frame, a class and a motion.

Batch k depends only on the seed and k, never on what was drawn before: a resumed run sees the same batches.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dexnudge.dataset.loading import Dataset, turn_clouds, turn_configurations, turn_vectors
from dexnudge.dataset.schema import BEHAVIOURS, direction_angles
from dexnudge.diffusion.config import TrainingConfig
from dexnudge.diffusion.network import GRASP, NON_PREHENSILE, NULL_CLASS, Condition
from dexnudge.errors import DatasetError

HEADED = 0.7  # share of tips that head along x, as a book does that is then pulled out; the others head anywhere
SLIDE = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # twist in frame C


@dataclass(frozen=True)
class TrainingBatch:
    """Rows of group g are g * rows_per_group .. (g + 1) * rows_per_group - 1; everything in frame C."""

    q: Float[Tensor, "row dimension"]
    points: Float[Tensor, "group point 6"]
    behaviour: Int[Tensor, " group"]
    twist: Float[Tensor, "group 6"]
    has_twist: Bool[Tensor, " group"]

    def condition(self, object_feature: Float[Tensor, "group feature"]) -> Condition:
        """Return one condition row per configuration."""
        rows = len(self.q) // len(self.points)
        return Condition(
            object_feature=object_feature.repeat_interleave(rows, dim=0),
            behaviour=self.behaviour.repeat_interleave(rows),
            twist=self.twist.repeat_interleave(rows, dim=0),
            has_twist=self.has_twist.repeat_interleave(rows),
        )

    def part(self, groups: slice) -> "TrainingBatch":
        """Return these groups with their rows."""
        rows = len(self.q) // len(self.points)
        of_q = slice(groups.start * rows, groups.stop * rows)
        return TrainingBatch(**{name: value[of_q if name == "q" else groups] for name, value in vars(self).items()})

    def to(self, device: torch.device) -> "TrainingBatch":
        """Return the same on another device."""
        return TrainingBatch(**{name: tensor.to(device) for name, tensor in vars(self).items()})


class BatchSampler:
    """Draws groups evenly over objects, and within an object evenly over the directions in which it can be moved.

    Without this the objects and directions that are easy to generate data for would crowd out the others. A share of the
    groups turns or tips its object, evenly over the ways in which it can be.
    """

    def __init__(self, dataset: Dataset, objects: Sequence[int], config: TrainingConfig) -> None:
        self.config = config
        self._q = torch.from_numpy(dataset.q)
        self._clouds = torch.from_numpy(dataset.clouds)
        is_grasp = dataset.behaviour == BEHAVIOURS.index("grasp")
        feasible = dataset.direction_margin >= config.min_direction_margin
        turning = dataset.turn_margin >= config.min_direction_margin
        self._turn_twists = dataset.turns
        self._turns: dict[int, dict[int, _Pool]] = {}  # object -> index into TURNS -> rows that can turn it so
        self._grasps: dict[int, _Pool] = {}
        self._moves: dict[int, dict[int, _Pool]] = {}  # object -> direction -> rows that can move it there
        for index in objects:
            of_object = dataset.object_index == index
            grasps = np.flatnonzero(of_object & is_grasp)
            pools, turns = (
                {
                    k: _Pool.of(rows, dataset.behaviour[rows], config.behaviour_balance)
                    for k in range(able.shape[1])
                    if len(rows := np.flatnonzero(of_object & ~is_grasp & able[:, k]))
                }
                for able in (feasible, turning)
            )
            if len(grasps) and config.grasp_fraction > 0.0:
                self._grasps[index] = _Pool.of(grasps, dataset.behaviour[grasps], config.behaviour_balance)
            if pools and config.grasp_fraction < 1.0:
                self._moves[index] = pools
                if turns and config.turn_fraction > 0.0:
                    self._turns[index] = turns
        if not self._grasps and not self._moves:
            raise DatasetError(
                f"none of {len(objects)} objects has a configuration to train on: expected grasps or configurations with "
                f"a force margin of at least {config.min_direction_margin} in some direction; generate more data."
            )

    def batch(self, index: int, *, stream: int = 0) -> TrainingBatch:
        """Return batch number `index` of random `stream`."""
        rng = np.random.default_rng([self.config.seed, stream, index])
        groups = [self._group(rng) for _ in range(self.config.groups)]
        objects, rows, yaws, behaviours, twists = zip(*groups, strict=True)
        yaw = torch.tensor(yaws, dtype=torch.float32)
        subset = rng.permutation(self._clouds.shape[1])[: self.config.num_points]
        points = turn_clouds(self._clouds[torch.tensor(objects)][:, torch.from_numpy(subset)], yaw)
        noise = rng.standard_normal((*points.shape[:2], 3), dtype=np.float32) * np.float32(self.config.point_noise)
        points[..., :3] += torch.from_numpy(noise)
        scale = 1.0 + self.config.scale_jitter * rng.uniform(-1.0, 1.0, (len(groups), 1, 1))
        points[..., :3] *= torch.from_numpy(scale.astype(np.float32))
        q = self._q[torch.from_numpy(np.concatenate(rows))]
        return TrainingBatch(
            q=turn_configurations(q, yaw.repeat_interleave(self.config.rows_per_group)),
            points=points,
            behaviour=torch.tensor(behaviours),
            twist=torch.tensor(np.array([np.zeros(6) if twist is None else twist for twist in twists])).float(),
            has_twist=torch.tensor([twist is not None for twist in twists]),
        )

    def _group(self, rng: np.random.Generator) -> tuple[int, np.ndarray, float, int, np.ndarray | None]:
        """Draw (object, rows, yaw [rad], behaviour, twist in frame C or None where it does not count)."""
        config = self.config
        wants_grasp = rng.random() < config.grasp_fraction
        drops = rng.random(3) < [config.unconditional_fraction, config.direction_dropout, config.behaviour_dropout]
        unconditional, drops_direction, drops_behaviour = drops
        any_yaw = rng.uniform(0.0, 2.0 * np.pi)
        if (wants_grasp and self._grasps) or not self._moves:
            index = int(rng.choice(list(self._grasps)))
            pool, behaviour, yaw, twist = self._grasps[index], GRASP, any_yaw, None
        else:
            index = int(rng.choice(list(self._moves)))
            turns = index in self._turns and rng.random() < config.turn_fraction
            moves = (self._turns if turns else self._moves)[index]
            chosen = int(rng.choice(list(moves)))
            pool, behaviour, yaw, twist = moves[chosen], NON_PREHENSILE, any_yaw, None
            jitter = rng.uniform(-config.yaw_jitter, config.yaw_jitter)
            if turns and not (unconditional or drops_direction):
                resting = self._turn_twists[index, chosen]
                heading = resting[[4, 3]] * [1.0, -1.0]  # angular x up
                if heading.any() and rng.random() < HEADED:
                    yaw = jitter - np.arctan2(heading[1], heading[0])
                twist = turn_vectors(torch.tensor(resting).view(2, 3), torch.tensor(yaw)).flatten().numpy()
            elif not (unconditional or drops_direction):
                yaw, twist = jitter - direction_angles()[chosen], SLIDE
        if unconditional or drops_behaviour:
            behaviour = NULL_CLASS
        return index, pool.draw(rng, config.rows_per_group), float(yaw), behaviour, twist


@dataclass(frozen=True)
class _Pool:
    """Rows, drawn with replacement, row k with probability cumulative[k] - cumulative[k - 1]."""

    rows: np.ndarray
    cumulative: np.ndarray

    @classmethod
    def of(cls, rows: np.ndarray, behaviour: np.ndarray, balance: float) -> "_Pool":
        """Return a pool with weight count^-balance for each row, count being the rows of its behaviour in this pool."""
        counts = np.bincount(behaviour)[behaviour].astype(np.float64)
        cumulative = np.cumsum(counts**-balance)
        return cls(rows, cumulative / cumulative[-1])

    def draw(self, rng: np.random.Generator, num: int) -> np.ndarray:
        chosen = np.searchsorted(self.cumulative, rng.random(num), side="right")
        return self.rows[np.minimum(chosen, len(self.rows) - 1)]
