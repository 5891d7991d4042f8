"""How fast a robot goes along its ways: through the open, in and out, and while it touches."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from dexnudge.arms.arm import JointLimits
from dexnudge.arms.robot import Robot
from dexnudge.planning.robot_motion import RobotClearance
from dexnudge.trajectories.plan import JointTrajectory
from dexnudge.trajectories.timing import CORNER, time_optimal, timed_way

CONTACT_SPEED = 0.05  # [m/s] of the hand on the last centimetres before contact
CLOSING_SPEED = 0.01  # [m/s] at which fingers and palm close the last 2 mm
CLOSING_STATIONS = 9
LOAD_TIME, SETTLE_TIME, RELEASE_TIME = 0.3, 0.2, 0.2  # [s] in which forces are built up, come to rest, and are let go
JOINT_MARGIN = 0.02  # [rad], [m] that an arm's joints keep from their limits: a controller stops the robot at them
FINGER_LEVER = 0.1  # [m] from a finger's joint to its tip
LEAST_STEP = 1.0e-6  # [m] between two stations: progress has to increase
LEAST_CLEARANCE = 0.001  # [m] of the rounded way through the open; where it is nearer, the robot stops at each corner


def closing(
    contact: Float[np.ndarray, " row"], pressing: Float[np.ndarray, " row"]
) -> Float[np.ndarray, "station row"]:
    """Return stations from contact to where the hand presses, both among them."""
    return contact + np.linspace(0.0, 1.0, CLOSING_STATIONS)[:, None] * (pressing - contact)


@dataclass(frozen=True, eq=False)
class Pace:
    """How fast a robot may go: at full speed within its limits, or at a share of it, for a first run.

    share: above 0, at most 1; of every velocity, its square of accelerations, its cube of jerks: the same motions, slower.
    """

    robot: Robot
    share: float = 1.0

    @cached_property
    def limits(self) -> JointLimits:
        """What the joints may do at this pace."""
        limits, share = self.robot.limits, self.share
        return replace(
            limits,
            velocity=limits.velocity * share,
            acceleration=limits.acceleration * share**2,
            jerk=limits.jerk * share**3,
        )

    def through(self, path: Float[np.ndarray, "vertex joint"], clearance: RobotClearance) -> JointTrajectory:
        """Return the way through the open, with round corners where there is room for them."""
        rounded = time_optimal(path, self.limits, corner=CORNER)
        if len(path) > 2 and clearance.of(rounded.position, stop=LEAST_CLEARANCE).min() < LEAST_CLEARANCE:
            return time_optimal(path, self.limits, corner=0.0)
        return rounded

    def along(self, path: Float[np.ndarray, "station joint"], *, speed: float | None = None) -> JointTrajectory:
        """Return the way along stations, palm and fingertips at `speed` [m/s] at most; None: as fast as the limits allow."""
        return self.passed(path, travelled(self.robot, path), speed=speed)

    def passed(
        self, path: Float[np.ndarray, "station joint"], progress: Float[np.ndarray, " station"], *, speed: float | None
    ) -> JointTrajectory:
        """Return the way along stations at `speed` [m/s] of progress, times the pace."""
        return timed_way(path, progress, self.limits, speed=None if speed is None else speed * self.share)


def with_margin(robot: Robot) -> Robot:
    """Return the robot whose arm keeps from its joints' limits, as far as its home does: what a planner may use."""
    arm, limits = robot.arm, robot.arm.limits
    lower = np.minimum(limits.lower + JOINT_MARGIN, np.maximum(limits.lower, arm.home))
    upper = np.maximum(limits.upper - JOINT_MARGIN, np.minimum(limits.upper, arm.home))
    return replace(robot, arm=replace(arm, limits=replace(limits, lower=lower, upper=upper)))


def travelled(robot: Robot, path: Float[np.ndarray, "station joint"]) -> Float[np.ndarray, " station"]:
    """Return how far the palm, or a fingertip by the fingers' turning, has come at each station [m], increasing."""
    q = robot.configurations(path)
    palm = np.linalg.norm(np.diff(q[:, :3], axis=0), axis=1)
    turned = np.abs(np.diff(path[:, robot.arm.num_joints :], axis=0)) / robot.hand.joint_scales
    steps = np.maximum(palm, FINGER_LEVER * turned.max(axis=1, initial=0.0))
    return np.concatenate([[0.0], np.cumsum(np.maximum(steps, LEAST_STEP))])


def rise(stay: JointTrajectory) -> Float[np.ndarray, " k"]:
    """Return at each sample of a stay a share that goes smoothly from 0 to 1."""
    share = stay.time / stay.time[-1]
    return np.asarray(share**2 * (3 - 2 * share))
