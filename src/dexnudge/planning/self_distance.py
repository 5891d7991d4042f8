"""How far a robot's links are from each other, by MuJoCo's collision detection of their convex hulls."""

from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from dexnudge.arms.robot import Robot
from dexnudge.jobs.cached import cached_per_instance

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
