"""A robot that travels: arm and fingers move together, straight in joint space, and touch nothing.

state = [arm's joint angles (n) [rad] | opening of the hand (1)]; for openings see `hand_motion`.
"""

from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.arms.robot import Robot
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.hands.hand import Hand
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.planning.hand_clearance import CAP, NO_STOP, OBSTACLES, Clearances, HandClearance
from dexnudge.planning.hand_motion import StateSpace
from dexnudge.scenes.scene import Scene

NEIGHBOURS = 0.003  # [m] links that are nearer than this at home are neighbours, whose contact is no collision
ARM_SIDE, HAND_SIDE = 1, 2  # bits of MuJoCo's contype: the hand's links are not tested against each other here


class SelfDistance:
    """Measures the least distance of the arm's links from each other and from the hand's, at most `most` [m]."""

    def __init__(self, robot: Robot, *, most: float) -> None:
        self._model, self._most = _hull_model(robot, most), most
        self._data = mujoco.MjData(self._model)
        moving = [joint for joint in robot.body.joints if joint is not None and joint.index is not None]
        self._place = np.array([self._model.joint(joint.name).qposadr[0] for joint in moving])
        self._index = np.array([joint.index for joint in moving])
        self._multiplier = np.array([joint.multiplier for joint in moving])
        self._offset = np.array([joint.offset for joint in moving])

    def __call__(self, position: Float[np.ndarray, " joint"]) -> float:
        """Return the distance [m] at a position of the robot; negative where links are in each other."""
        self._move(position)
        return min(self._most, float(self._data.contact.dist.min())) if self._data.ncon else self._most

    def nearest(self, position: Float[np.ndarray, " joint"]) -> tuple[str, str]:
        """Return the two links that are nearest to each other; empty texts where all are farther than `most`."""
        self._move(position)
        if not self._data.ncon:
            return "", ""
        one, other = self._model.geom_bodyid[self._data.contact.geom[int(self._data.contact.dist.argmin())]]
        return self._model.body(one).name, self._model.body(other).name

    def _move(self, position: Float[np.ndarray, " joint"]) -> None:
        self._data.qpos[self._place] = self._multiplier * position[self._index] + self._offset
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)


@cached_per_instance
def _hull_model(robot: Robot, margin: float) -> Any:
    """Return MuJoCo's model of the robot's links as convex hulls, with contacts of those pairs that must not touch."""
    body = robot.body
    bodies: list[Any] = []
    spec = mujoco.MjSpec()
    for link, name in enumerate(body.link_names):
        joint = body.joints[link]
        parent = spec.worldbody if joint is None else bodies[body.link_parent[link]]
        made = parent.add_body(name=name, mass=1.0, inertia=(1.0, 1.0, 1.0), explicitinertial=True)
        bodies.append(made)
        if joint is not None:
            quaternion = np.zeros(4)
            mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(joint.origin[:3, :3]).reshape(9))
            made.pos, made.quat = joint.origin[:3, 3], quaternion
            if joint.index is not None:
                kind = mujoco.mjtJoint.mjJNT_SLIDE if joint.slides else mujoco.mjtJoint.mjJNT_HINGE
                made.add_joint(name=joint.name, type=kind, axis=joint.axis)
        mesh = body.link_meshes[link]
        if len(mesh.faces):
            of_arm = name in body.coarse_links
            spec.add_mesh(name=name, uservert=np.asarray(mesh.convex_hull.vertices, dtype=np.float64).reshape(-1))
            geom = made.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, margin=margin)
            geom.contype = ARM_SIDE if of_arm else HAND_SIDE
            geom.conaffinity = ARM_SIDE | HAND_SIDE if of_arm else ARM_SIDE
    for one, other in _neighbours(robot, spec.compile()):
        spec.add_exclude(bodyname1=one, bodyname2=other)
    return spec.compile()


def _neighbours(robot: Robot, model: Any) -> set[tuple[str, str]]:
    data = mujoco.MjData(model)
    home = dict(zip(robot.joint_names, robot.arm.home.tolist(), strict=False))
    for joint in robot.body.joints:
        if joint is not None and joint.index is not None:
            angle = home.get(robot.joint_names[joint.index], 0.0)
            data.qpos[model.joint(joint.name).qposadr[0]] = joint.multiplier * angle + joint.offset
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    near = data.contact.geom[data.contact.dist < NEIGHBOURS]
    return {(model.body(one).name, model.body(other).name) for one, other in model.geom_bodyid[near]}


@dataclass(frozen=True)
class RobotSpace:
    """The meaning of a robot's states, for a hand that closes and opens as `fingers` says."""

    robot: Robot
    fingers: StateSpace

    def positions(self, states: Float[np.ndarray, "n state"]) -> Float[np.ndarray, "n joint"]:
        """Return the joint angles of arm and hand."""
        return np.concatenate([states[:, :-1], self.fingers.joint_angles(states[:, -1])], axis=1)

    def placed(
        self, states: Float[np.ndarray, "n state"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n joint"]]:
        """Return the pose of the arm's base and the joint angles."""
        return placed(self.robot, self.positions(states))

    def between(
        self, start: Float[np.ndarray, " state"], end: Float[np.ndarray, " state"], fraction: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n state"]:
        """Return states at fractions of the straight motion."""
        return start + np.asarray(fraction)[:, None] * (end - start)

    def displacement(self, start: Float[np.ndarray, " state"], end: Float[np.ndarray, " state"]) -> float:
        """Return a bound on the way of any point of the robot on the straight motion between two states [m]."""
        change = np.abs(end - start)
        return float(change[:-1] @ levers(self.robot) + change[-1] * self.fingers.sweep)


def placed(
    robot: Robot, positions: Float[np.ndarray, "n joint"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n joint"]]:
    """Return positions with the pose of the arm's base for each, as `RobotClearance` takes them."""
    base, count = robot.arm.T_world_base, len(positions)
    return np.tile(base[:3, 3], (count, 1)), np.tile(base[:3, :3], (count, 1, 1)), positions


@cached_per_instance
def levers(robot: Robot) -> Float[np.ndarray, " n"]:
    """Return a bound on what any point moves for unit change of each of the arm's joints [m/rad]; 1 where one slides."""
    body = robot.body
    far = np.array([np.linalg.norm(mesh.vertices, axis=1).max(initial=0.0) for mesh in body.link_meshes])
    found = np.ones(robot.arm.num_joints)
    for link in reversed(range(1, len(body.link_names))):
        joint, parent = body.joints[link], int(body.link_parent[link])
        assert joint is not None
        reach = float(np.linalg.norm(joint.origin[:3, 3]))
        if joint.index is not None and joint.slides:
            reach += float(np.abs([body.lower[joint.index], body.upper[joint.index]]).max())
        elif joint.index is not None and joint.index < robot.arm.num_joints:
            found[joint.index] = max(far[link], 1e-3)
        far[parent] = max(far[parent], reach + far[link])
    return found


class RobotClearance(HandClearance):
    """Measures how far a robot is from the surroundings, from the object, and from itself.

    An arm's links count as 7 mm thicker than they are. `check_base` checks its base, which does not move. With
    `hand` off, distances from surroundings and object are those of the arm's links alone.
    """

    def __init__(self, robot: Robot, scene: Scene, *, hand: bool = True) -> None:
        super().__init__(robot.body if hand else _arm_alone(robot), scene)
        self._robot, self._scene = robot, scene
        self._itself = SelfDistance(robot, most=CAP)

    def __call__(
        self,
        translation: Float[np.ndarray, "n 3"],
        rotation: Float[np.ndarray, "n 3 3"],
        joint_angles: Float[np.ndarray, "n joint"],
        *,
        stop: float = NO_STOP,
    ) -> Clearances:
        """Return the clearances, in a third column those of the robot's links from each other; see `HandClearance`."""
        own = np.array([self._itself(row) for row in joint_angles]).reshape(-1, 1)
        found = super().__call__(translation, rotation, joint_angles[:, : self.hand.num_joints], stop=stop)
        return Clearances(np.concatenate([found.distance, own], axis=1), found.nearest)

    def of(self, positions: Float[np.ndarray, "n joint"], *, stop: float = NO_STOP) -> Float[np.ndarray, " n"]:
        """Return the least clearance at each position [m]."""
        return self(*placed(self._robot, positions), stop=stop).distance.min(axis=1)

    def what_blocks(self, position: Float[np.ndarray, " joint"]) -> str:
        """Return what is nearest to what at a position, in words."""
        found = self(*placed(self._robot, position[None]))
        column = int(found.distance[0].argmin())
        depth = f"{1e3 * max(0.0, found.distance[0, column]):.0f} mm"
        if column == len(OBSTACLES):
            one, other = self._itself.nearest(position)
            return f"'{one}' is {depth} from '{other}'"
        q = self._robot.coordinates(position[None])[0, : 9 + self.hand.num_joints]
        link, place = self.link_and_point(int(found.nearest[0, column]), q)
        mesh: trimesh.Trimesh = (
            self._scene.environment_mesh if OBSTACLES[column] == "environment" else self._scene.object_in_world()
        )
        near = ", ".join(f"{value:.2f}" for value in ExactDistance(mesh)(place[None]).closest[0])
        thing = "the surroundings" if OBSTACLES[column] == "environment" else "the object"
        return f"'{link}' is {depth} from {thing} at ({near}) m"


@cached_per_instance
def _arm_alone(robot: Robot) -> Hand:
    """Return the arm's links of the robot's body."""
    body, joints, links = robot.body, robot.arm.num_joints, len(robot.arm.tree.links)
    return replace(
        body,
        joint_names=body.joint_names[:joints],
        lower=body.lower[:joints],
        upper=body.upper[:joints],
        link_names=body.link_names[:links],
        link_parent=body.link_parent[:links],
        joints=body.joints[:links],
        link_meshes=body.link_meshes[:links],
        fingertips={},
        couplings=(),
    )
