"""A robot arm: the chain from its base to its flange, and what its joints may do."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.errors import ArmError, SceneError
from dexnudge.geometry.rigid import rigid_transform
from dexnudge.hands.joint_ranges import line_of
from dexnudge.hands.tree import Tree, TreeJoint

REACH_DRAWS, REACH_KEPT = 2000, 20  # joint angles drawn at a time, and the farthest around which the next are drawn
REACH_SPREADS = (0.1, 0.03, 0.01, 0.003, 0.001, 0.0)  # of the joints' ranges, in which they are drawn


@dataclass(frozen=True)
class JointLimits:
    """What n joints may do; of a joint that slides metres stand for radians, newtons for newton metres.

    lower, upper [rad]. velocity [rad/s], acceleration [rad/s^2], jerk [rad/s^3]: of either sign. effort [N m].
    """

    lower: Float[np.ndarray, " n"]
    upper: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " n"]
    acceleration: Float[np.ndarray, " n"]
    jerk: Float[np.ndarray, " n"]
    effort: Float[np.ndarray, " n"]

    def room(self, position: Float[np.ndarray, "k n"]) -> Float[np.ndarray, " k"]:
        """Return the least distance of a joint to its limits, as a share of half its range; below 0 outside."""
        least = np.minimum(position - self.lower, self.upper - position)
        return np.asarray((least / ((self.upper - self.lower) / 2)).min(axis=1))

    def __add__(self, other: "JointLimits") -> "JointLimits":
        """Return the limits of these joints and then of the others'."""
        return JointLimits(**{name: np.concatenate([one, vars(other)[name]]) for name, one in vars(self).items()})


@dataclass(frozen=True, eq=False, repr=False)
class Arm:
    """An arm of n joints that stands in the world.

    Attributes:
        name: what messages call it.
        tree: its links, parents first, and joints from the base, the root, to the flange and no farther; collision geometry.
        joint_names: the n joints from the base to the flange.
        limits: of these.
        home: joint angles from which a plan starts and to which it returns [rad].
        flange: link that a hand is mounted on; its z-axis points out of the arm.
        T_world_base: where it stands.
        notes: what was assumed when the description was read, a sentence each.
        source: the description file; None for an arm that is no file's.
    """

    name: str
    tree: Tree
    joint_names: tuple[str, ...]
    limits: JointLimits
    home: Float[np.ndarray, " n"]
    flange: str
    T_world_base: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    notes: tuple[str, ...] = ()
    source: Path | None = None

    @property
    def num_joints(self) -> int:
        """n, the number of joints."""
        return len(self.joint_names)

    def standing_at(self, T_world_base: Float[np.ndarray, "4 4"]) -> "Arm":
        """Return the same arm with its base elsewhere.

        Raises:
            ArmError: no rigid pose.
        """
        return replace(self, T_world_base=rigid_pose(T_world_base, "T_world_base"))

    @cached_property
    def chain(self) -> tuple[TreeJoint, ...]:
        """The joints from the base to the flange, fixed ones among them."""
        return tuple(self.tree.chain_to(self.flange))

    @property
    def base(self) -> str:
        """The link that stands on the ground."""
        return self.chain[0].parent

    def rigid_with(self, link: str) -> set[str]:
        """Return the links that never move against a link, itself among them."""
        found, fixed = {link}, [joint for joint in self.tree.joints if joint.fixed]
        for _ in fixed:
            found |= {end for one in fixed for end in (one.parent, one.child) if {one.parent, one.child} & found}
        return found

    @cached_property
    def lines(self) -> dict[str, tuple[int, float, float]]:
        """Of each joint that moves: the entry of the joint angles that it follows, with what factor and offset."""
        joints = {joint.name: joint for joint in self.tree.joints}
        found = {name: (index, 1.0, 0.0) for index, name in enumerate(self.joint_names)}
        for name, joint in joints.items():
            line = None if joint.fixed or name in found else line_of(joints, name)
            if line is not None:
                leader, factor, offset = line
                found[name] = (self.joint_names.index(leader), factor, offset)
        return found

    def flange_poses(self, positions: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "k 4 4"]:
        """Return T_world_flange at joint angles."""
        return self._poses(positions, self.chain)[self.flange]

    def link_poses(self, position: Float[np.ndarray, " n"]) -> dict[str, Float[np.ndarray, "4 4"]]:
        """Return T_world_link of every link at joint angles."""
        joints = [self.tree.carrier[link] for link in self.tree.links if link in self.tree.carrier]
        return {link: pose[0] for link, pose in self._poses(position[None], joints).items()}

    def _poses(
        self, positions: Float[np.ndarray, "k n"], joints: Sequence[TreeJoint]
    ) -> dict[str, Float[np.ndarray, "k 4 4"]]:
        """Return T_world_link of the base and of what hangs from these joints, parents first."""
        poses = {self.base: np.tile(self.T_world_base, (len(positions), 1, 1))}
        for joint in joints:
            index, factor, offset = self.lines.get(joint.name, (0, 0.0, 0.0))
            motion = np.tile(np.eye(4), (len(positions), 1, 1))
            values = (factor * positions[:, index] + offset)[:, None]
            if joint.slides and not joint.fixed:
                motion[:, :3, 3] = values * joint.axis
            elif not joint.fixed:
                motion[:, :3, :3] = Rotation.from_rotvec(values * joint.axis).as_matrix()
            poses[joint.child] = poses[joint.parent] @ joint.origin @ motion
        return poses

    @cached_property
    def reach(self) -> float:
        """Greatest distance of the flange's origin from the base's [m], searched for among random joint angles."""
        low, high = self.limits.lower, self.limits.upper
        generator, at_origin = np.random.default_rng(0), replace(self, T_world_base=np.eye(4))
        found, far = generator.uniform(low, high, (REACH_DRAWS, self.num_joints)), np.zeros(0)
        for spread in REACH_SPREADS:
            far = np.linalg.norm(at_origin.flange_poses(found)[:, :3, 3], axis=1)
            best = found[far.argsort()[-REACH_KEPT:]]
            around = generator.normal(scale=spread, size=(REACH_DRAWS, self.num_joints)) * (high - low)
            found = np.concatenate([best, np.clip(best[np.arange(REACH_DRAWS) % len(best)] + around, low, high)])
        return float(far.max())

    def __repr__(self) -> str:
        place = ", ".join(f"{value:.2f}" for value in self.T_world_base[:3, 3])
        return f"Arm '{self.name}': {self.num_joints} joints, flange '{self.flange}', base at ({place})"


def rigid_pose(value: Any, name: str) -> Float[np.ndarray, "4 4"]:
    """Return `value` as a rigid transform; ArmError where it is none."""
    try:
        return rigid_transform(value, name, unscaled="check the numbers")
    except SceneError as error:
        raise ArmError(str(error)) from error
