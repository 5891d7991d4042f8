"""A hand that travels: its states, eight numbers of palm pose and opening of the fingers, and its motion over time.

state = [translation (3) [m, world] | quaternion wxyz (4) of the palm | opening (1)]. Opening 0 is the grip of the goal,
1 the hand with joint angles as near zero as its limits allow, and jaws that slide as far apart; between them the joint
angles are linear.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.hands.hand import ROOT_COORDINATES, Hand

QUATERNION = slice(3, 7)
ALMOST_EQUAL = 1e-9  # 1 - |cosine| below which two rotations are interpolated linearly: slerp divides by the sine
SWEEP_STEPS = 16  # steps in which the way of the fingers' points is summed

States = Float[np.ndarray, "_ 8"]  # any number of them
State = Float[np.ndarray, "8"]


@dataclass(frozen=True)
class StateSpace:
    """The meaning of a hand's states, and how far the hand's points move between two of them.

    closed, opened: joint angles [rad] at opening 0 and 1, sliding joints [m]. scales: see `Hand.joint_scales`.
    reach: of the hand's farthest point from the palm's origin, at any opening [m]. sweep: the longest way of a point,
    in the palm's frame, from opening 0 to 1 [m].
    """

    closed: Float[np.ndarray, " joint"]
    opened: Float[np.ndarray, " joint"]
    scales: Float[np.ndarray, " joint"]
    reach: float
    sweep: float

    def joint_angles(self, opening: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n joint"]:
        """Return the joint angles [rad] of each opening."""
        return self.closed + np.asarray(opening)[:, None] * (self.opened - self.closed)

    def placed(
        self, states: States
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n joint"]]:
        """Return translation [m] and rotation of each state's palm, world, and its joint angles [rad]."""
        return states[:, :3], matrices(states), self.joint_angles(states[:, 7])

    def between(self, start: State, end: State, fraction: Float[np.ndarray, " n"]) -> States:
        """Return states at fractions of the straight motion; see `between`."""
        return between(start, end, fraction)

    def displacement(self, start: State, end: State) -> float:
        """Return a bound on the way of any point of the hand on the straight motion between two states [m]."""
        turn = rotation_angle(start, end)
        return float(np.linalg.norm(end[:3] - start[:3]) + turn * self.reach + abs(end[7] - start[7]) * self.sweep)

    def configurations(self, states: States) -> Float[np.ndarray, "n coordinates"]:
        """Return the states as q = [translation | 6D rotation | joint angles]."""
        columns = matrices(states)[:, :, :2]
        rotation_6d = np.concatenate([columns[:, :, 0], columns[:, :, 1]], axis=1)
        return np.concatenate([states[:, :3], rotation_6d, self.joint_angles(states[:, 7])], axis=1)


def state_space(hand: Hand, closed: Float[np.ndarray, " joint"]) -> StateSpace:
    """Return the space of a hand that is to close to the joint angles `closed` [rad]."""
    opened = hand.clamp(hand.at_origin(hand.apart[None]))[0, ROOT_COORDINATES:].numpy()
    steps = np.linspace(0.0, 1.0, SWEEP_STEPS + 1)[:, None]
    T = hand.forward_kinematics(hand.at_origin(closed + steps * (opened - closed))).numpy()
    points = hand.sparse_points
    placed = np.einsum("slij,lj->sli", T[:, points.link, :3, :3], points.points) + T[:, points.link][..., :3, 3]
    way = np.linalg.norm(np.diff(placed, axis=0), axis=2).sum(axis=0)
    reach = float(np.linalg.norm(placed, axis=2).max())
    return StateSpace(np.asarray(closed, dtype=float), opened, hand.joint_scales, reach, way.max())


def state(T_world_palm: Float[np.ndarray, "4 4"] | Float[np.ndarray, "3 4"], opening: float) -> State:
    """Return the state of a palm's pose."""
    x, y, z, w = Rotation.from_matrix(T_world_palm[:3, :3]).as_quat()
    return np.array([*T_world_palm[:3, 3], w, x, y, z, opening])


def palm_pose(q: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, "4 4"]:
    """Return T_world_palm of a configuration; the two stored columns are made orthonormal."""
    x = q[3:6] / np.linalg.norm(q[3:6])
    y = q[6:9] - (q[6:9] @ x) * x
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, y / np.linalg.norm(y), np.zeros(3)], axis=1)
    pose[:3, 2] = np.cross(pose[:3, 0], pose[:3, 1])
    pose[:3, 3] = q[:3]
    return pose


def matrices(states: States) -> Float[np.ndarray, "n 3 3"]:
    """Return the rotation of each state's palm."""
    w, x, y, z = states[:, QUATERNION].T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def rotation_angle(start: State, end: State) -> float:
    """Return the angle of the shortest turn from one state's palm to the other's [rad]."""
    chord = min(
        np.linalg.norm(start[QUATERNION] - end[QUATERNION]), np.linalg.norm(start[QUATERNION] + end[QUATERNION])
    )
    return float(4.0 * np.arcsin(min(0.5 * chord, 1.0)))


def between(start: State, end: State, fraction: Float[np.ndarray, " n"]) -> States:
    """Return states at fractions of the straight motion: translation and opening linear, rotation by slerp."""
    t = np.asarray(fraction, dtype=float)[:, None]
    states = start + t * (end - start)
    first, last = start[QUATERNION], end[QUATERNION]
    if first @ last < 0:
        last = -last
    if 1.0 - first @ last < ALMOST_EQUAL:
        turned = first + t * (last - first)
    else:
        angle = 2.0 * np.arcsin(min(0.5 * np.linalg.norm(last - first), 1.0))
        turned = (np.sin((1 - t) * angle) * first + np.sin(t * angle) * last) / np.sin(angle)
    states[:, QUATERNION] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    return states


BASE_SPEED = 0.25  # [m/s] of the palm's origin
CONTACT_SPEED = 0.05  # [m/s] the same on the last stretch, where the fingers meet the object
TURN_SPEED = 1.5  # [rad/s] of the palm: a wrist's usual half of its rated speed
JOINT_SPEED = 2.0  # [rad/s of `Hand.joint_scales`] of every finger joint
SAMPLE_INTERVAL = 0.02  # [s] most between two samples: 5 mm at the base's speed


@dataclass(frozen=True)
class Trajectory:
    """Configurations of a hand at increasing times.

    times: [s], from 0. q: world frame. Between two samples everything but the rotation is linear; the rotation turns about
    one axis.
    """

    times: Float[np.ndarray, " sample"]
    q: Float[np.ndarray, "sample coordinates"]

    @property
    def duration(self) -> float:
        """From the first to the last sample [s]."""
        return float(self.times[-1] - self.times[0])


def timed(space: StateSpace, path: States, *, contact_from: int) -> Trajectory:
    """Time a path of states: as fast as the limits above allow, each straight piece at constant speed.

    From the state `contact_from` on, the base keeps to the slower CONTACT_SPEED.
    """
    fastest_joint = float((np.abs(space.opened - space.closed) / space.scales).max())
    times, states = [0.0], [path[:1]]
    for index, (start, end) in enumerate(pairwise(path)):
        speed = CONTACT_SPEED if index >= contact_from else BASE_SPEED
        seconds = max(
            float(np.linalg.norm(end[:3] - start[:3])) / speed,
            rotation_angle(start, end) / TURN_SPEED,
            abs(end[7] - start[7]) * fastest_joint / JOINT_SPEED,
        )
        if seconds == 0.0:
            continue
        count = int(np.ceil(seconds / SAMPLE_INTERVAL))
        fraction = np.arange(1, count + 1) / count
        times += list(times[-1] + fraction * seconds)
        states.append(between(start, end, fraction))
    return Trajectory(np.array(times), space.configurations(np.concatenate(states)))


def joined(first: Trajectory | None, second: Trajectory) -> Trajectory:
    """Join `first` and `second`, which begins where `first` ends."""
    if first is None or first.duration == 0.0:
        return second
    times = np.concatenate([first.times, first.times[-1] + second.times[1:]])
    return Trajectory(times, np.concatenate([first.q, second.q[1:]]))
