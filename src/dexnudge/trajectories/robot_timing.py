"""How fast a robot goes along its ways: through the open, in and out, and while it touches."""

import numpy as np
from jaxtyping import Float

from dexnudge.arms.robot import Robot
from dexnudge.planning.robot_motion import RobotClearance
from dexnudge.trajectories.plan import JointTrajectory
from dexnudge.trajectories.timing import CORNER, time_optimal, timed_way

CONTACT_SPEED = 0.05  # [m/s] of the hand on the last centimetres before contact
CLOSING_SPEED = 0.01  # [m/s] at which fingers and palm close the last 2 mm
CLOSING_STATIONS = 9
LOAD_TIME, SETTLE_TIME, RELEASE_TIME = 0.3, 0.2, 0.2  # [s] in which forces are built up, come to rest, and are let go
FINGER_LEVER = 0.1  # [m] from a finger's joint to its tip
LEAST_STEP = 1.0e-6  # [m] between two stations: progress has to increase
LEAST_CLEARANCE = 0.001  # [m] of the rounded way through the open; where it is nearer, the robot stops at each corner


def closing(
    contact: Float[np.ndarray, " row"], pressing: Float[np.ndarray, " row"]
) -> Float[np.ndarray, "station row"]:
    """Return stations from contact to where the hand presses, both among them."""
    return contact + np.linspace(0.0, 1.0, CLOSING_STATIONS)[:, None] * (pressing - contact)


def through(robot: Robot, path: Float[np.ndarray, "vertex joint"], clearance: RobotClearance) -> JointTrajectory:
    """Return the way through the open, with round corners where there is room for them."""
    rounded = time_optimal(path, robot.limits, corner=CORNER)
    if len(path) > 2 and clearance.of(rounded.position, stop=LEAST_CLEARANCE).min() < LEAST_CLEARANCE:
        return time_optimal(path, robot.limits, corner=0.0)
    return rounded


def along(robot: Robot, path: Float[np.ndarray, "station joint"], *, speed: float | None = None) -> JointTrajectory:
    """Return the way along stations, palm and fingertips at `speed` [m/s] at most; None: as fast as the limits allow."""
    return timed_way(path, travelled(robot, path), robot.limits, speed=speed)


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
