"""A closed loop of an MJCF hand, solved: poses that close it, the joints that drive it, and poses over their range."""

import copy
from dataclasses import dataclass
from itertools import product

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares

from dexnudge.errors import HandError

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
        for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon, mujoco.mj_transmission):
            stage(model, data)  # not its inertia, which may be singular
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


CLOSED = 1e-4  # [m] residual of a closed loop
HOLDS = 5e-4  # [m/rad] least singular value of a constraint; below, it holds nothing
INDEPENDENT = 0.05  # sine of the least angle between joints that drive a loop
SAMPLES = {1: 33, 2: 9, 3: 5, 4: 4}  # of a driving joint's range, by the number of these joints
STARTS = 12  # poses from which a loop is closed for the first time
LOOP_WEIGHT, SPRING_WEIGHT, STAY_WEIGHT = 1.0 / CLOSED, 1.0, 1e-2  # a loop closes within 1 um though springs pull
JUMP, JITTER = 5.0, 1e-3  # a follower's way [m], per way of the leaders, and beside it; more is another branch
BEYOND = 1e-3  # [rad or m] of a limit, which rounding in the description may take
POLISH, RANK = 3, 1e-2  # Newton steps, and the least singular value in them, of the largest
FULL_TURN = 2 * np.pi  # [rad] either way: a joint of a loop without limits


@dataclass(frozen=True)
class Loop:
    """Joints (numbers in the model) that equalities tie together."""

    joints: tuple[int, ...]  # the nearest to the palm first
    equalities: tuple[int, ...]
    name: str


class Closing:
    """Solves one loop of a model for given values of some of its joints; the model's other joints rest."""

    def __init__(self, equalities: Equalities, loop: Loop) -> None:
        model = equalities.model
        self.equalities, self.loop, self.model = equalities, loop, model
        joints = np.asarray(loop.joints)
        self.names = {j: model.joint(j).name or f"joint{j}" for j in loop.joints}
        self.qpos, self.dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self.lower, self.upper = limits_of(model, FULL_TURN)[:, joints]
        self.zero = np.clip(model.qpos0[self.qpos], self.lower, self.upper)
        self.slides = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE
        stiffness = np.atleast_2d(model.jnt_stiffness.T).T[joints, 0]
        self.spring = SPRING_WEIGHT * np.sqrt(stiffness / max(stiffness.max(), 1e-12))
        self.rest = model.qpos_spring[self.qpos]

    def residual(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return residuals [m], Jacobian by the loop's joints, and the equality of each row."""
        qpos = self.model.qpos0.copy()
        qpos[self.qpos] = values
        residual, jacobian, owner = self.equalities(qpos)
        own = np.isin(owner, self.loop.equalities)
        return residual[own], jacobian[own][:, self.dofs], owner[own]

    def offset(self, values: np.ndarray) -> float:
        """Return the largest distance [m] at one of the loop's equalities."""
        residual, _, owner = self.residual(values)
        return max(float(np.linalg.norm(residual[owner == equality])) for equality in self.loop.equalities)

    def close(self, start: np.ndarray, fixed: list[int]) -> np.ndarray:
        """Return the pose near `start`, with the columns `fixed` held, that closes the loop and rests its springs."""
        free = [column for column in range(len(start)) if column not in fixed]
        if not free:
            return start
        lower, upper = self.lower[free], self.upper[free]
        margin = 1e-6 * (upper - lower) + 1e-12

        def pull(x: np.ndarray) -> np.ndarray:
            values = start.copy()
            values[free] = x
            loop = LOOP_WEIGHT * self.residual(values)[0]
            return np.concatenate([loop, (self.spring * (values - self.rest))[free], STAY_WEIGHT * (x - start[free])])

        def slope(x: np.ndarray) -> np.ndarray:
            values = start.copy()
            values[free] = x
            loop = LOOP_WEIGHT * self.residual(values)[1][:, free]
            return np.concatenate([loop, np.diag(self.spring[free]), STAY_WEIGHT * np.eye(len(free))])

        inside = np.clip(start[free], lower + margin, upper - margin)
        found = least_squares(
            pull,
            inside,
            slope,
            bounds=(lower - margin, upper + margin),
            xtol=1e-10,
            ftol=1e-10,
            gtol=1e-10,
            max_nfev=60,
        )
        values = start.copy()
        values[free] = found.x
        for _ in range(POLISH):  # by the least step, so that springs and limits still settle what the loop leaves free
            residual, jacobian, _ = self.residual(values)
            values[free] -= np.linalg.lstsq(jacobian[:, free], residual, rcond=RANK)[0]
        values[free] = np.clip(values[free], lower - BEYOND, upper + BEYOND)
        return values

    def starts(self) -> list[np.ndarray]:
        """Return poses that close the loop, the one nearest to the model's own first."""
        rng = np.random.default_rng(0)
        tries = [self.zero, (self.lower + self.upper) / 2]
        tries += [rng.uniform(self.lower, self.upper) for _ in range(STARTS)]
        poses = [self.close(pose, []) for pose in tries]
        offsets = [self.offset(pose) for pose in poses]
        if min(offsets) > CLOSED:
            raise HandError(
                f"{self.loop.name} cannot be closed: expected a pose within the joints' limits that closes it, got "
                f"{min(offsets) * 1e3:.3g} mm at best; mend the anchors or the limits"
            )
        closed = [pose for pose, offset in zip(poses, offsets, strict=True) if offset <= CLOSED]
        return sorted(closed, key=lambda pose: float(np.linalg.norm(pose - self.zero)))

    def leaders(self, starts: list[np.ndarray], driven: list[int]) -> list[int]:
        """Return the joints that drive the loop: as many as it leaves free and no spring settles."""
        units = np.where(self.slides, LEVER, 1.0)
        free: np.ndarray = np.zeros((len(units), len(units) + 1))
        for pose in starts:
            jacobian = self.residual(pose)[1] * units
            _, strength, directions = np.linalg.svd(jacobian)
            null = directions[int((strength > HOLDS).sum()) :].T
            free = null if null.shape[1] < free.shape[1] else free
        if not free.shape[1]:
            raise HandError(
                f"{self.loop.name} holds its joints {[self.names[j] for j in self.loop.joints]} in one place: expected a "
                "loop that can move; remove the equality that is too much, or the joints"
            )
        basis = np.zeros((0, free.shape[1]))

        def settles(joint: int) -> bool:
            nonlocal basis
            way = free[self.loop.joints.index(joint)]
            rest = way - basis.T @ (basis @ way)
            if np.linalg.norm(rest) >= INDEPENDENT:
                basis = np.vstack([basis, rest / np.linalg.norm(rest)])
                return True
            return False

        leaders = [joint for joint in driven if settles(joint)]
        sprung = [joint for column, joint in enumerate(self.loop.joints) if self.spring[column] > 0.0]
        if not leaders:
            leaders = [next(joint for joint in (*self.loop.joints, *sprung) if joint not in sprung and settles(joint))]
        for joint in sprung:
            settles(joint)
        return leaders + [joint for joint in self.loop.joints if settles(joint)]

    def over_range(self, starts: list[np.ndarray], leaders: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the leaders all over their range (n, leaders), where the loop closes (n,), and all joints (n, joints).

        Each pose starts from the nearest one that is known, so that all lie on one branch of the loop.
        """
        if len(leaders) not in SAMPLES:
            raise HandError(
                f"{self.loop.name} leaves {len(leaders)} joints free: expected at most {max(SAMPLES)} that drive a loop; "
                "replace it by <joint> equalities"
            )
        columns = [self.loop.joints.index(joint) for joint in leaders]
        lower, upper = self.lower[columns], self.upper[columns]
        steps = SAMPLES[len(leaders)]
        grid = np.array(list(product(*np.linspace(lower, upper, steps).T)))
        units = (grid - lower) / np.maximum(upper - lower, 1e-12)
        start = self.close(starts[0], columns)
        at = (start[columns] - lower) / np.maximum(upper - lower, 1e-12)
        known_at, known = [at], [start]
        lengths = np.where(self.slides, 1.0, LEVER)
        closed, values = np.zeros(len(grid), dtype=bool), np.zeros((len(grid), len(start)))
        for row in np.argsort(np.linalg.norm(units - at, axis=1), kind="stable"):
            nearest = int(np.argmin(np.linalg.norm(np.array(known_at) - units[row], axis=1)))
            pose = known[nearest].copy()
            pose[columns] = grid[row]
            values[row] = self.close(pose, columns)
            step, jump = (np.abs(lengths * (other - known[nearest])).max() for other in (pose, values[row]))
            closed[row] = self.offset(values[row]) <= CLOSED and jump <= JUMP * step + JITTER
            if closed[row]:
                known_at.append(units[row])
                known.append(values[row])
        return grid, closed, values
