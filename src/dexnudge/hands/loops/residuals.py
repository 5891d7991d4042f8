"""What an MJCF's equalities and motors tie together: their residuals by MuJoCo itself, and the joints that they concern."""

import copy

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

LEVER = 0.05  # [m] turns angles into lengths: a finger's link
LOOPS = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
DRIVES = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT, mujoco.mjtTrn.mjTRN_TENDON)
TRIES = 4  # random poses that show which joints an equality or a motor concerns
RANGE = 3.0  # [rad] or [m] either way, of a joint without limits, in these poses


class Equalities:
    """Residuals of a model's active equalities, in metres: angles count at a lever of 5 cm."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = _kinematics_only(model)
        turning = (model.eq_type == mujoco.mjtEq.mjEQ_WELD) & (model.eq_data[:, 10] != 0.0)
        self.model.eq_data[turning, 10] = 2 * LEVER  # `torquescale`, which multiplies sin(angle / 2)
        self.data = mujoco.MjData(self.model)
        by_angle = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) | (model.eq_type == mujoco.mjtEq.mjEQ_TENDON)
        self._scale = np.where(by_angle, LEVER, 1.0)

    def __call__(
        self, qpos: Float[np.ndarray, " nq"]
    ) -> tuple[Float[np.ndarray, " row"], Float[np.ndarray, "row nv"], Int[np.ndarray, " row"]]:
        """Return the residuals [m], their Jacobian and the equality that each row belongs to."""
        model, data = self.model, self.data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_makeConstraint(model, data)
        rows = int(data.ne)
        owner = data.efc_id[:rows].copy()
        jacobian = data.efc_J.reshape(-1, model.nv)[:rows] if rows else np.zeros((0, model.nv))
        return data.efc_pos[:rows] * self._scale[owner], jacobian * self._scale[owner][:, None], owner

    def dofs(self) -> Bool[np.ndarray, "equality nv"]:
        """Return which degrees of freedom each equality concerns: of a loop, those on the way between its two ends."""
        model = self.model
        concerned = np.zeros((model.neq, model.nv), dtype=bool)
        for qpos in random_poses(model):
            _, jacobian, owner = self(qpos)
            np.logical_or.at(concerned, owner, np.abs(jacobian) > 1e-9)
        for equality in np.flatnonzero(np.isin(model.eq_type, [int(kind) for kind in LOOPS])):
            one, other = (dofs_above(model, body) for body in ends(model, int(equality)))
            concerned[equality] &= one ^ other  # where the loop is open, what carries both ends turns its gap
        return concerned


def ends(model: mujoco.MjModel, equality: int) -> tuple[int, int]:
    """Return the two bodies that a `connect` or `weld` joins."""
    pair = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
        return int(model.site_bodyid[pair[0]]), int(model.site_bodyid[pair[1]])
    return pair


def dofs_above(model: mujoco.MjModel, body: int) -> Bool[np.ndarray, " nv"]:
    """Return which degrees of freedom move a body."""
    moving = np.zeros(model.nv, dtype=bool)
    while body > 0:
        moving |= model.dof_bodyid == body
        body = int(model.body_parentid[body])
    return moving


def motor_dofs(model: mujoco.MjModel) -> Bool[np.ndarray, "motor nv"]:
    """Return which degrees of freedom each actuator drives, directly or by a tendon."""
    kinds = [int(kind) for kind in DRIVES]
    model = _kinematics_only(model)
    driven = np.zeros((model.nu, model.nv), dtype=bool)
    data = mujoco.MjData(model)
    for qpos in random_poses(model):
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, data)
        for motor in range(model.nu):
            if int(model.actuator_trntype[motor]) in kinds:
                entries = slice(data.moment_rowadr[motor], data.moment_rowadr[motor] + data.moment_rownnz[motor])
                driven[motor, data.moment_colind[entries]] |= np.abs(data.actuator_moment[entries]) > 1e-9
    return driven


def _kinematics_only(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy whose only constraints are its equalities."""
    model, off = copy.deepcopy(model), mujoco.mjtDisableBit
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    model.opt.disableflags = off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_FRICTIONLOSS
    return model


def random_poses(model: mujoco.MjModel) -> list[Float[np.ndarray, " nq"]]:
    """Return a few poses within the limits of hinges and slides; other joints rest."""
    rng = np.random.default_rng(0)
    lower, upper = limits_of(model, RANGE)
    poses = []
    for _ in range(TRIES):
        qpos = model.qpos0.copy()
        for joint in range(model.njnt):
            if np.isfinite(lower[joint]):
                qpos[model.jnt_qposadr[joint]] = rng.uniform(lower[joint], upper[joint])
        poses.append(qpos)
    return poses


def limits_of(model: mujoco.MjModel, free: float) -> Float[np.ndarray, "2 joint"]:
    """Return the least and greatest value of each hinge or slide, `free` about zero without limits; NaN for others."""
    simple = (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) | (model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)
    limits = np.where(model.jnt_limited[:, None] != 0, model.jnt_range, (-free, free))
    return np.where(simple[:, None], limits, np.nan).T
