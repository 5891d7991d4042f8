"""A robot arm: the chain from its base to its flange, and what its joints may do."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from dexnudge.errors import ArmError, SceneError
from dexnudge.geometry.rigid import rigid_transform
from dexnudge.hands.tree import Tree, TreeJoint

REACH_STARTS, REACH_CLIMBS = 2000, 4  # random joint angles, and how many of the farthest are improved


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
            ArmError: no rigid pose.
        """
        return replace(self, T_world_base=rigid_pose(T_world_base, "T_world_base"))

    @cached_property
    def chain(self) -> tuple[TreeJoint, ...]:
        """The joints from the base to the flange, fixed ones among them."""
        carrier = {joint.child: joint for joint in self.tree.joints}
        found, link = [], self.flange
        while link in carrier:
            found.append(carrier[link])
            link = carrier[link].parent
        return tuple(reversed(found))

    @property
    def base(self) -> str:
        """The link that stands on the ground."""
        return self.chain[0].parent

    def flange_poses(self, positions: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "k 4 4"]:
        """Return T_world_flange at joint angles."""
        pose = np.tile(self.T_world_base, (len(positions), 1, 1))
        for joint in self.chain:
            pose = pose @ joint.origin
            if not joint.fixed:
                pose = pose @ _motions(joint, self._values(joint, positions))
        return np.asarray(pose)

    def _values(self, joint: TreeJoint, positions: Float[np.ndarray, "k n"]) -> Float[np.ndarray, " k"]:
        return np.asarray(positions[:, self.joint_names.index(joint.name)])

    @cached_property
    def reach(self) -> float:
        """Greatest distance of the flange's origin from the base's [m], searched for among random joint angles."""
        low, high = self.limits.lower, self.limits.upper
        starts = np.random.default_rng(0).uniform(low, high, (REACH_STARTS, self.num_joints))
        at_origin = replace(self, T_world_base=np.eye(4))

        def nearness(position: Float[np.ndarray, " n"]) -> float:
            return -float(np.linalg.norm(at_origin.flange_poses(position[None])[0, :3, 3]))

        far = np.linalg.norm(at_origin.flange_poses(starts)[:, :3, 3], axis=1).argsort()[-REACH_CLIMBS:]
        climbs = [minimize(nearness, starts[row], bounds=list(zip(low, high, strict=True))).fun for row in far]
        return -float(min(climbs))

    def __repr__(self) -> str:
        place = ", ".join(f"{value:.2f}" for value in self.T_world_base[:3, 3])
        return f"Arm '{self.name}': {self.num_joints} joints, flange '{self.flange}', base at ({place})"


def rigid_pose(value: Any, name: str) -> Float[np.ndarray, "4 4"]:
    """Return `value` as a rigid transform; ArmError where it is none."""
    try:
        return rigid_transform(value, name, unscaled="check the numbers")
    except SceneError as error:
        raise ArmError(str(error)) from error


def _motions(joint: TreeJoint, values: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k 4 4"]:
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    if joint.slides:
        poses[:, :3, 3] = values[:, None] * joint.axis
    else:
        poses[:, :3, :3] = Rotation.from_rotvec(values[:, None] * joint.axis).as_matrix()
    return poses
