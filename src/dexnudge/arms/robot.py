"""An arm with a hand at its flange: one kinematic tree, whose joints are the arm's and then the hand's."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float

from dexnudge.arms.arm import Arm, JointLimits
from dexnudge.hands.hand import Hand, Joint
from dexnudge.hands.motors import JOINT_EFFORT, JOINT_VELOCITY
from dexnudge.hands.tree import Tree, TreeJoint, rerooted
from dexnudge.jobs.cached import cached_per_instance

FINGER_ACCELERATION = 20.0  # [rad/s^2] ten times Shadow's published velocity limit: it is reached in 0.1 s
FINGER_JERK = 400.0  # [rad/s^3] the acceleration is reached in 50 ms


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """An arm that carries a hand.

    A position holds the joint angles of arm and hand, n + d numbers [rad], [m] of joints that slide.

    Attributes:
        arm: the arm, where it stands.
        hand: the hand.
        T_flange_mount: pose of the hand's mount, its base or else its palm, in the flange's frame.
    """

    arm: Arm
    hand: Hand
    T_flange_mount: Float[np.ndarray, "4 4"]

    @property
    def mount(self) -> str:
        """The hand's link that is fixed to the flange."""
        return self.hand.base_link or self.hand.link_names[0]

    @property
    def flange(self) -> str:
        """The arm's flange, as `body` calls it."""
        return _unique(self.arm.flange, self.hand.link_names, self.arm.name)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The arm's joints, then the hand's."""
        return self.body.joint_names

    @cached_property
    def limits(self) -> JointLimits:
        """Limits of arm and hand; of the hand nominal ones, for joints with a tendon's gear."""
        scales = self.hand.joint_scales
        fingers = JointLimits(
            lower=np.asarray(self.hand.lower, dtype=float),
            upper=np.asarray(self.hand.upper, dtype=float),
            velocity=JOINT_VELOCITY * scales,
            acceleration=FINGER_ACCELERATION * scales,
            jerk=FINGER_JERK * scales,
            effort=JOINT_EFFORT / scales,
        )
        return self.arm.limits + fingers

    @cached_property
    def body(self) -> Hand:
        """Arm and hand as one tree of links whose root is the arm's base; the arm's links and joints stand first."""
        return _body(self)

    @cached_property
    def palm(self) -> int:
        """Index of the palm in the links of `body`."""
        return self.body.link_names.index(self.hand.link_names[0])

    def coordinates(self, positions: Float[np.ndarray, "k joint"]) -> Float[np.ndarray, "k coordinates"]:
        """Return q of `body`: the pose of the arm's base, then the positions."""
        root = np.concatenate([self.arm.T_world_base[:3, 3], *self.arm.T_world_base[:3, :2].T])
        return np.concatenate([np.tile(root, (len(positions), 1)), positions], axis=1)

    def link_poses(self, positions: Float[np.ndarray, "k joint"]) -> Float[np.ndarray, "k link 4 4"]:
        """Return T_world_link of the links of `body` at positions."""
        return self.body.forward_kinematics(torch.from_numpy(self.coordinates(positions))).numpy()

    def at_home(self) -> Float[np.ndarray, "link 4 4"]:
        """Return T_world_link of the links of `body` with the arm at home and the hand open."""
        opened = np.clip(self.hand.apart, self.hand.lower, self.hand.upper)
        return self.link_poses(np.concatenate([self.arm.home, opened])[None])[0]

    def palm_poses(self, positions: Float[np.ndarray, "k joint"]) -> Float[np.ndarray, "k 4 4"]:
        """Return T_world_palm at positions."""
        return np.asarray(self.link_poses(positions)[:, self.palm] @ self._T_link_palm)

    def configurations(self, positions: Float[np.ndarray, "k joint"]) -> Float[np.ndarray, "k coordinates"]:
        """Return q of the hand at positions."""
        poses = self.palm_poses(positions)
        fingers = positions[:, self.arm.num_joints :]
        return np.concatenate([poses[:, :3, 3], poses[:, :3, 0], poses[:, :3, 1], fingers], axis=1)

    def flange_poses(self, q: Float[np.ndarray, "k coordinates"]) -> Float[np.ndarray, "k 4 4"]:
        """Return where the flange must be, T_world_flange, for the hand to stand at q."""
        mount = self.hand.link_names.index(self.mount)
        T_world_mount = self.hand.forward_kinematics(torch.from_numpy(np.asarray(q, dtype=np.float64)))[
            :, mount
        ].numpy()
        return np.asarray(T_world_mount @ np.linalg.inv(self.T_flange_mount))

    @cached_property
    def _T_link_palm(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the palm's frame, as q has it, in the frame that the palm has in `body`, which may hang from its base."""
        zero = np.zeros((1, self.arm.num_joints + self.hand.num_joints))
        T_world_link, flange = self.link_poses(zero)[0], self.body.link_names.index(self.flange)
        T_palm_link = self.hand.forward_kinematics(self.hand.at_origin(zero[:, self.arm.num_joints :]))[0].numpy()
        T_palm_mount = T_palm_link[self.hand.link_names.index(self.mount)]
        T_world_palm = T_world_link[flange] @ self.T_flange_mount @ np.linalg.inv(T_palm_mount)
        return np.asarray(np.linalg.inv(T_world_link[self.palm]) @ T_world_palm)

    def __repr__(self) -> str:
        return f"Robot: {self.hand.name} on {self.arm.name}, {len(self.joint_names)} joints"


def _unique(name: str, taken: tuple[str, ...], prefix: str) -> str:
    """Return a name of the arm's that none of the hand's has."""
    return f"{prefix}_{name}" if name in taken else name


def _body(robot: Robot) -> Hand:
    arm, hand = robot.arm, robot.hand
    rename = {name: _unique(name, hand.link_names, arm.name) for name in arm.tree.links}
    of_hand = {joint.name: joint for joint in hand.joints if joint is not None}
    root, T_flange_root = _root(robot)
    hanging = _hanging(hand, root)
    above: dict[str, tuple[str, Joint]] = {}  # of each link, its parent and the joint between them
    for joint in arm.tree.joints:
        index, factor, offset = (None, 1.0, 0.0) if joint.fixed else arm.lines[joint.name]
        name = _unique(joint.name, tuple(of_hand), arm.name)
        made = Joint(name, joint.origin, joint.axis, index, factor, offset, joint.slides)
        above[rename[joint.child]] = rename[joint.parent], made
    fixed = Joint(f"{arm.name}_{hand.name}_mount", T_flange_root, np.array([0.0, 0.0, 1.0]), None)
    above[root] = rename[arm.flange], fixed
    for joint in hanging.joints:
        own = of_hand[joint.name]
        index = None if own.index is None else arm.num_joints + own.index
        above[joint.child] = joint.parent, replace(own, origin=joint.origin, axis=joint.axis, index=index)
    meshes = {rename[name]: mesh for name, mesh in arm.tree.links.items()} | hanging.links
    links = [*rename.values(), root, *(joint.child for joint in hanging.joints_below(root))]
    return Hand(
        name=f"{arm.name}_{hand.name}",
        joint_names=(*(_unique(name, tuple(of_hand), arm.name) for name in arm.joint_names), *hand.joint_names),
        lower=robot.limits.lower,
        upper=robot.limits.upper,
        link_names=tuple(links),
        link_parent=np.array([links.index(above[link][0]) if link in above else -1 for link in links]),
        joints=tuple(above[link][1] if link in above else None for link in links),
        link_meshes=tuple(meshes[link] for link in links),
        fingertips=hand.fingertips,
        couplings=hand.couplings,
        palm_normal=hand.palm_normal,
        base_link=hand.base_link,
        coarse_links=frozenset(rename.values()),
        shown_by=(*(() if arm.source is None else (arm.source,)), *hand.shown_by),
    )


def _root(robot: Robot) -> tuple[str, Float[np.ndarray, "4 4"]]:
    """Return the hand's link that hangs from the flange, and its pose there: the palm, unless a wrist bends before it."""
    hand, link = robot.hand, robot.hand.link_names.index(robot.mount)
    T_palm_mount = np.eye(4)
    while link > 0:
        joint = hand.joints[link]
        assert joint is not None
        if joint.index is not None:
            return robot.mount, robot.T_flange_mount
        T_palm_mount = joint.origin @ T_palm_mount
        link = int(hand.link_parent[link])
    return hand.link_names[0], robot.T_flange_mount @ np.linalg.inv(T_palm_mount)


@cached_per_instance
def _hanging(hand: Hand, mount: str) -> Tree:
    """Return the hand as a tree from its mount; remembered, so that meshes are the same for every robot with this hand."""
    joints = []
    for link, joint in enumerate(hand.joints):
        if joint is not None:
            parent, child = hand.link_names[hand.link_parent[link]], hand.link_names[link]
            joints.append(TreeJoint(joint.name, parent, child, joint.origin, joint.axis, joint.index is None))
    links = dict(zip(hand.link_names, hand.link_meshes, strict=True))
    return rerooted(Tree(hand.name, links, tuple(joints)), mount)
