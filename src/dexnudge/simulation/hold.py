"""Whether a grasp holds in MuJoCo: its squeeze, DexGraspBench's force test (Chen et al., 2025), and a rehearsal of a lift.

In the force test the hand squeezes; then a force of 10 * mass newtons pulls at the object's centre of mass for two seconds
along each of six axes. A grasp holds if the object never gets 5 cm or 15 degrees away from where it was before.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import trimesh
from jaxtyping import Float
from scipy.optimize import nnls

from dexnudge.hands.hand import Hand
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.friction_cone import EDGE_COUNT, UP, friction_cone_edges, wrenches
from dexnudge.mechanics.sliding_task import GRAVITY
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hand_path import waiting
from dexnudge.simulation.model import (
    ENVIRONMENT_SIDE,
    GRASP_FRICTION,
    GRASP_MASS,
    SimulationModel,
    changed_physics,
    grasp_model,
)
from dexnudge.simulation.rollout import Rollout

SQUEEZE = 14.0  # [N] wanted sum of all normal forces, before the limit per link
STRONGEST_LINK = 5.0  # [N] normal force of one link; what a tendon-driven finger holds continuously
BALANCE = 100.0  # weight of the net wrench against the sum of the forces: balance comes first
EVENNESS = 0.1  # weight of each edge's own size: forces spread over contacts and keep to the middle of their cones


def squeeze(
    simulation: SimulationModel, contacts: HandContacts, *, half_length: float, friction: float = GRASP_FRICTION
) -> tuple[Float[np.ndarray, "contact 3"], Float[np.ndarray, " motor"]]:
    """Return forces on the object [N, frame of the contacts] whose net wrench is nearly zero, and the motor torques [N m].

    Of the grasp at which `simulation` was placed; the forces stay inside cones of this `friction`.
    Non-negative least squares over the edges of the contacts' friction pyramids: no net wrench first (torques over
    `half_length` [m]), then a sum of normal forces near SQUEEZE, then evenly spread; scaled down until no link presses
    harder than STRONGEST_LINK. A force f of the hand at a contact takes the joint torques J^T f; a motor that two
    joints share takes the mean of theirs, since its tendon pulls on both alike. Of a motor that slides it is a force [N].
    """
    edges = friction_cone_edges(contacts.normals, UP, friction=friction)
    centre = np.array(simulation.data.xipos[simulation.object_body])
    wrench = wrenches(contacts.points[:, None], edges, centre=centre, half_length=half_length).reshape(-1, 6)
    count = len(wrench)
    rows = np.concatenate([BALANCE * wrench.T, np.ones((1, count)), EVENNESS * np.eye(count)])
    wanted = np.zeros(len(rows))
    wanted[6] = SQUEEZE
    size, _ = nnls(rows, wanted)
    strongest = np.bincount(np.repeat(contacts.link, EDGE_COUNT), weights=size).max()
    size *= min(1.0, STRONGEST_LINK / max(strongest, STRONGEST_LINK))
    force = np.einsum("ck,ckx->cx", size.reshape(-1, EDGE_COUNT), edges)
    torque = np.einsum("cxa,cx->a", simulation.contact_jacobians(contacts), force)
    return force, torque @ simulation.angle_of_motor


FARTHEST = 0.05  # [m] this and the next are DexGraspBench's limits of a grasp that holds
MOST_TURNED = float(np.radians(15.0))

FIRST_STOP = 8  # checks before an object can be called at rest: 0.3 s, many time constants of the motors
WINDOW = 2  # checks over which its speed is taken
REST_SHARE = 0.1  # of a limit that it would still cover at that speed
SPEED_UP = 4.0  # it must stay within the limits even at this many times that speed


@dataclass(frozen=True)
class ObjectPose:
    """centre: of mass [m]. quaternion: wxyz, unit."""

    centre: Float[np.ndarray, " 3"]
    quaternion: Float[np.ndarray, " 4"]

    def distance(self, other: "ObjectPose") -> tuple[float, float]:
        """Return (translation of the centre of mass [m], angle of rotation [rad]) between two poses."""
        cosine = min(1.0, abs(float(self.quaternion @ other.quaternion)))
        return float(np.linalg.norm(self.centre - other.centre)), 2.0 * float(np.arccos(cosine))

    def share(self, other: "ObjectPose") -> float:
        """Return the distance in units of the limits, the larger of translation and rotation: above 1 the object drops."""
        translation, rotation = self.distance(other)
        return max(translation / FARTHEST, rotation / MOST_TURNED)


def object_pose(simulation: SimulationModel) -> ObjectPose:
    """Return where the object is now."""
    data, free = simulation.data, simulation.object_position
    return ObjectPose(np.array(data.xipos[simulation.object_body]), np.array(data.qpos[free + 3 : free + 7]))


def at_rest(start: ObjectPose, poses: Sequence[ObjectPose], checks_left: int) -> bool:
    """Return whether the rest of a pull cannot change that the object is held.

    It is no faster now than in the window before; at its present speed it would cover less than a tenth of the limits in
    the time that is left; and even at four times that speed it would stay within nine tenths of them.

    The limits are measured from `start`; `poses` are one per check since the pull began, `checks_left` until it ends.
    """
    if len(poses) < max(FIRST_STOP, 2 * WINDOW + 1):
        return False
    now, before, long_before = poses[-1], poses[-1 - WINDOW], poses[-1 - 2 * WINDOW]
    windows = checks_left / WINDOW
    ahead = now.share(before) * windows
    slowing = now.share(before) <= before.share(long_before)
    return slowing and ahead < REST_SHARE and start.share(now) + SPEED_UP * ahead < 1.0 - REST_SHARE


PULL = 10.0 * GRASP_MASS  # [N]
PULL_STEPS = 500  # 2 s, as in DexGraspBench
DIRECTIONS = np.concatenate([np.eye(3), -np.eye(3)])

CLOSING_UPDATES, CLOSING_STEPS, RAMP = 10, 5, 5  # the squeeze grows over 5 updates of 5 steps, then 5 more hold it
LEAST_SQUEEZE = 1.0  # [N] sum of the contact forces; as strong as the pull
SETTLING_STEPS = 25  # 0.1 s with fixed targets
CHECK_STEPS = 10  # between two checks of the object


@dataclass(frozen=True)
class Held:
    """The result for one grasp.

    reason: "" if it held, else "no contact", "no squeeze" (forces of its contacts cannot balance), "drops" (the object
    moved too far) or "diverges" (the simulation did). translation [m] and rotation [rad]: greatest distance from the
    start at any check. steps: of simulation.
    """

    held: bool
    reason: str
    translation: float
    rotation: float
    steps: int


class HoldTest:
    """Tests grasps of one hand on one object; a result depends on its grasp alone, not on what was tested before.

    The frame of `object_mesh` [m] is that of q and of the contacts. With `full_length` pulls go on for their two seconds
    even when the object has come to rest.

    Raises:
        MeshError: the object cannot be cut into convex pieces.
    """

    def __init__(self, hand: Hand, object_mesh: trimesh.Trimesh, *, full_length: bool = False) -> None:
        self._grasp = grasp_model(hand, object_mesh)
        self._half_length = float(np.max(object_mesh.extents)) / 2
        self._full_length = full_length
        model = self._grasp.model
        self._state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))

    def __call__(self, q: Float[np.ndarray, "n coordinates"], contacts: Sequence[HandContacts]) -> list[Held]:
        """Test each grasp q, whose contacts come from the check of its geometry."""
        return [self._test(row, contact) for row, contact in zip(q, contacts, strict=True)]

    def _test(self, q: Float[np.ndarray, " coordinates"], contacts: HandContacts) -> Held:
        self._grasp.place(np.asarray(q, dtype=np.float64))
        run = _Run(object_pose(self._grasp))
        if len(contacts.points) == 0:
            return run.verdict("no contact")
        force, motor_torque = squeeze(self._grasp, contacts, half_length=self._half_length)
        # Forces that hold a pull and its opposite add up to a squeeze: contacts that allow none cannot hold both.
        if float(np.linalg.norm(force, axis=1).sum()) < LEAST_SQUEEZE:
            return run.verdict("no squeeze")
        self._close(motor_torque, run)
        reason = run.check(object_pose(self._grasp))
        if reason:
            return run.verdict(reason)
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        mujoco.mj_getState(self._grasp.model, self._grasp.data, self._state, kind)
        for direction in DIRECTIONS:
            mujoco.mj_setState(self._grasp.model, self._grasp.data, self._state, kind)
            reason = self._pull(direction, run)
            if reason:
                return run.verdict(reason)
        return run.verdict("")

    def _close(self, motor_torque: Float[np.ndarray, " motor"], run: "_Run") -> None:
        """Bring the motors to the wanted torques, whatever gaps they close on the way, and keep their targets there."""
        model, data = self._grasp.model, self._grasp.data
        idle = self._grasp.idle(motor_torque)
        place = np.array(data.ctrl)
        low, high = model.actuator_ctrlrange.T
        for update in range(CLOSING_UPDATES):
            share = min(1.0, (update + 1) / RAMP)
            target = data.actuator_length + share * motor_torque / self._grasp.motor_gain
            data.ctrl[:] = np.clip(np.where(idle, place, target), low, high)
            self._step(CLOSING_STEPS, run)
        self._step(SETTLING_STEPS, run)

    def _pull(self, direction: Float[np.ndarray, " 3"], run: "_Run") -> str:
        self._grasp.data.xfrc_applied[self._grasp.object_body, :3] = PULL * direction
        poses: list[ObjectPose] = []
        for done in range(CHECK_STEPS, PULL_STEPS + 1, CHECK_STEPS):
            self._step(CHECK_STEPS, run)
            poses.append(object_pose(self._grasp))
            reason = run.check(poses[-1])
            if reason:
                return reason
            if not self._full_length and at_rest(run.start, poses, (PULL_STEPS - done) // CHECK_STEPS):
                break
        return ""

    def _step(self, steps: int, run: "_Run") -> None:
        mujoco.mj_step(self._grasp.model, self._grasp.data, nstep=steps)
        run.steps += steps


@dataclass
class _Run:
    """What has been measured of one grasp so far."""

    start: ObjectPose
    translation: float = 0.0
    rotation: float = 0.0
    steps: int = 0

    def check(self, pose: ObjectPose) -> str:
        """Note a pose, and return the reason why the test ends here, or "" if it goes on."""
        translation, rotation = self.start.distance(pose)
        if not np.isfinite(translation + rotation):
            return "diverges"
        self.translation, self.rotation = max(self.translation, translation), max(self.rotation, rotation)
        return "drops" if self.start.share(pose) > 1.0 else ""

    def verdict(self, reason: str) -> Held:
        """Return the result so far; no reason means that the grasp holds."""
        return Held(not reason, reason, self.translation, self.rotation, self.steps)


HEAVIER = 1.25  # times the mass: what a scale or a guess may be wrong by
SLIPPERIER = 0.75  # times the friction of the hand
HELD_TIME = 1.0  # [s]


class LiftRehearsal:
    """Rehearses lifts of a scene's object in free space, the object heavier and more slippery than it should be.

    Of the model of hand and scene, the surroundings are left out.
    """

    def __init__(self, simulation: SimulationModel, scene: Scene) -> None:
        self._simulation = changed_physics(simulation, friction_hand=SLIPPERIER, mass=HEAVIER)
        model, surroundings = self._simulation.model, self._simulation.side == ENVIRONMENT_SIDE
        model.geom_contype[surroundings] = model.geom_conaffinity[surroundings] = 0
        self._friction = SLIPPERIER * scene.friction_hand
        self._half_length = 0.5 * float(np.max(scene.object_mesh.extents))

    def __call__(
        self,
        q: Float[np.ndarray, " coordinates"],
        contacts: HandContacts,
        T_world_object: Float[np.ndarray, "4 4"],
    ) -> float:
        """Return how far the object moves under its weight, as a share of the hold test's limits; infinite if it diverges.

        The grasp is given by q and contacts (world) with the object at `T_world_object`: gravity acts as it will then.
        """
        simulation = replace(self._simulation, T_world_object=T_world_object)
        simulation.model.opt.gravity[:] = 0.0
        rollout = Rollout(simulation, q, recorded=False)
        start = object_pose(simulation)
        _, motor_torque = squeeze(simulation, contacts, half_length=self._half_length, friction=self._friction)
        rollout.close(motor_torque, "close")
        simulation.model.opt.gravity[:] = 0.0, 0.0, -GRAVITY
        rollout.follow(waiting(q, seconds=HELD_TIME), "hold")
        return float("inf") if rollout.divergence else start.share(object_pose(simulation))
