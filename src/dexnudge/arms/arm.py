"""A robot arm: the chain from its base to its flange, and what its joints may do."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from dexnudge.geometry.rigid import rigid_transform
from dexnudge.hands.tree import Tree


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

    def __add__(self, other: "JointLimits") -> "JointLimits":
        """Return the limits of these joints and then of the others'."""
        return JointLimits(**{name: np.concatenate([one, vars(other)[name]]) for name, one in vars(self).items()})


@dataclass(frozen=True, eq=False, repr=False)
class Arm:
    """An arm of n joints that stands in the world.

    Attributes:
        name: what messages call it.
        tree: its links and joints from the base, the root, to the flange and no farther; collision geometry.
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
            SceneError: no rigid pose.
        """
        return replace(self, T_world_base=rigid_transform(T_world_base, "T_world_base", unscaled="check the numbers"))

    def __repr__(self) -> str:
        place = ", ".join(f"{value:.2f}" for value in self.T_world_base[:3, 3])
        return f"Arm '{self.name}': {self.num_joints} joints, flange '{self.flange}', base at ({place})"
