"""Where a hand's base and fingers should be at every step: along a planned way, along a line, at rest, or for a push."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.scenes.motion import Motion
from dexnudge.simulation.model import TIMESTEP

Path = Float[np.ndarray, "step coordinates"]  # q (world) at every step

SPEED = 0.05  # [m/s] of the object's fastest point along the motion
PHASES = SETTLE, _, SQUEEZE, PUSH, STOP = ("settle", "approach", "squeeze", "push", "stop")  # of a push
SETTLE_TIME = 0.1  # [s] in which the object comes to rest on its supports, untouched
SQUEEZE_TIME = 0.4  # [s] in which the fingers close the last 2 mm and the forces build up
RAMP_TIME = 0.1  # [s] in which each stage of the motion gets to its speed, and stops
LEAST_TURNING = 1.0e-3  # [rad/m] below which a stage slides
STOP_TIME = 0.1  # [s] in which the object comes to rest with the hand


def along_way(times: Float[np.ndarray, " sample"], q: Float[np.ndarray, "sample coordinates"]) -> Path:
    """Follow q (world) given at increasing `times` [s]; empty for a single sample.

    Between samples everything but the rotation is linear; the rotation turns about one axis.
    """
    if len(times) < 2:
        return np.zeros((0, q.shape[1]))
    clock = times[0] + TIMESTEP * np.arange(1, round((times[-1] - times[0]) / TIMESTEP) + 1)
    clock = np.minimum(clock, times[-1])
    path = interpolated(clock, times, q)
    matrices = Slerp(times, rotations(q))(clock).as_matrix()
    path[:, 3:6], path[:, 6:ROOT_COORDINATES] = matrices[:, :, 0], matrices[:, :, 1]
    return path


def along_line(q: Float[np.ndarray, " coordinates"], shift: Float[np.ndarray, " 3"], *, speed: float) -> Path:
    """Move the base by `shift` [m, world] as (1 - cos) / 2, at `speed` [m/s] in the middle; the fingers stay."""
    length = float(np.linalg.norm(shift))
    count = int(np.ceil(np.pi / 2 * length / speed / TIMESTEP))
    path = np.tile(q, (count, 1))
    path[:, :3] += 0.5 * (1 - np.cos(np.pi * np.arange(1, count + 1) / max(count, 1)))[:, None] * shift
    return path


def bending(
    q: Float[np.ndarray, " coordinates"], angles: Float[np.ndarray, " joint"], *, speed: Float[np.ndarray, " joint"]
) -> Path:
    """Move the joints evenly to `angles` [rad], none faster than its `speed` [rad/s], sliding ones in metres."""
    change = angles - q[ROOT_COORDINATES:]
    count = int(np.ceil((np.abs(change) / speed).max() / TIMESTEP))
    path = np.tile(q, (count, 1))
    path[:, ROOT_COORDINATES:] += np.arange(1, count + 1)[:, None] / max(count, 1) * change
    return path


def waiting(q: Float[np.ndarray, " coordinates"], *, seconds: float) -> Path:
    """Stay at q."""
    return np.tile(q, (round(seconds / TIMESTEP), 1))


def palm_velocity(path: Path, before: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, "step 6"]:
    """Return the velocity of the palm's target, linear [m/s] then angular [rad/s], in the axes of that target.

    before: q of the step before the first.
    """
    rotation = rotations(np.concatenate([before[None], path]))
    turned = (rotation[1:] * rotation[:-1].inv()).as_rotvec()
    linear = np.diff(np.concatenate([before[None], path])[:, :3], axis=0)
    to_palm = rotation[1:].inv()
    return np.concatenate([to_palm.apply(linear), to_palm.apply(turned)], axis=1) / TIMESTEP


@dataclass(frozen=True)
class PushPath:
    """Targets of a push per step.

    position [m] and quaternion (wxyz) of the palm, world. angles: joint angles [rad]. phase: one of PHASES. done: share of
    the push's length that is behind the hand. displacement: by which the motion has carried the object since contact, a
    rigid transform in the world. length: of the push [m].
    """

    position: Float[np.ndarray, "step 3"]
    quaternion: Float[np.ndarray, "step 4"]
    angles: Float[np.ndarray, "step angle"]
    phase: np.ndarray
    done: Float[np.ndarray, " step"]
    displacement: Float[np.ndarray, "step 4 4"]
    length: float

    @property
    def velocity(self) -> Float[np.ndarray, "step 6"]:
        """Of the palm's target, linear [m/s] then angular [rad/s], world; zero at the first step."""
        rotation = Rotation.from_quat(self.quaternion, scalar_first=True)
        turned = (rotation[1:] * rotation[:-1].inv()).as_rotvec()
        linear = np.diff(self.position, axis=0)
        return np.concatenate([np.zeros((1, 6)), np.concatenate([linear, turned], axis=1) / TIMESTEP])


def push_path(
    times: Float[np.ndarray, " sample"],
    q: Float[np.ndarray, "sample coordinates"],
    *,
    motion: Motion,
    length: float,
) -> PushPath:
    """Follow q (world) at `times` [s, from 0] to contact, squeeze, and go `length` [m] of the object's `motion` with it.

    With a single sample the hand starts at contact. Each stage of the motion takes its length / SPEED + RAMP_TIME: it speeds
    up and slows down evenly, and goes at 0.05 m/s in between.
    """
    approach = float(times[-1]) if len(times) > 1 else 0.0
    stages = motion.parts(length)
    seconds = (SETTLE_TIME, approach, SQUEEZE_TIME, sum(_seconds(stage) for stage in stages), STOP_TIME)
    steps = [round(each / TIMESTEP) for each in seconds]
    phase = np.repeat(PHASES, steps)
    began = steps[0] * TIMESTEP
    clock = (np.arange(len(phase)) + 1) * TIMESTEP
    along = np.clip(clock - began, times[0], times[-1])
    rotation = rotations(q)
    turned = Slerp(times, rotation)(along) if len(times) > 1 else rotation[np.zeros(len(phase), dtype=int)]
    pushed, travelled = clock - began - (steps[1] + steps[2]) * TIMESTEP, np.zeros(len(phase))
    for stage in stages:
        travelled += _travelled(pushed, stage)
        pushed = pushed - _seconds(stage)
    displacement = np.stack([motion.displacement(way) for way in travelled])
    if motion.turn is not None:
        turned = Rotation.from_matrix(displacement[:, :3, :3]) * turned
    position = np.einsum("sxy,sy->sx", displacement[:, :3, :3], interpolated(along, times, q[:, :3]))
    return PushPath(
        position=position + displacement[:, :3, 3],
        quaternion=turned.as_quat(scalar_first=True),
        angles=interpolated(along, times, q[:, ROOT_COORDINATES:]),
        phase=phase,
        done=travelled / length,
        displacement=displacement,
        length=length,
    )


def twists(path: PushPath) -> Float[np.ndarray, "step 6"]:
    """Return the twist of the object's planned motion at every step: a point x (world) moves at v + w x x per metre of way.

    v [m/m], then w [rad/m]; where the object rests, that of the nearest step at which it moves.
    """
    way, pose = path.done * path.length, path.displacement
    moving = np.flatnonzero(np.diff(way) > 0)
    step = pose[moving + 1] @ np.linalg.inv(pose[moving])
    size = np.diff(way)[moving][:, None]
    angular = Rotation.from_matrix(step[:, :3, :3]).as_rotvec() / size
    middle = (pose[moving + 1, :3, 3] + pose[moving, :3, 3]) / 2
    linear = (pose[moving + 1, :3, 3] - pose[moving, :3, 3]) / size - np.cross(angular, middle)
    nearest = np.abs(np.arange(len(way))[:, None] - moving).argmin(axis=1)
    return np.concatenate([linear, angular], axis=1)[nearest]


def stage_ends(path: PushPath) -> list[int]:
    """Return the last step of every stage of the motion: of its turn, and of its slide."""
    turning = np.linalg.norm(twists(path)[:, 3:], axis=1) > LEAST_TURNING
    pushing = path.phase == PUSH
    changes = np.flatnonzero(pushing[:-1] & (turning[1:] != turning[:-1]))
    return [*changes.tolist(), int(np.flatnonzero(pushing)[-1])]


def _seconds(length: float) -> float:
    return length / SPEED + RAMP_TIME


def _travelled(time: Float[np.ndarray, " step"], length: float) -> Float[np.ndarray, " step"]:
    """Return the distance [m] since a stage of this length began: even acceleration, constant speed, even deceleration."""
    ramp = min(RAMP_TIME, length / SPEED)
    whole = length / SPEED + ramp
    time = np.clip(time, 0.0, whole)
    left = whole - time
    speeding, slowing = np.minimum(time, ramp), np.minimum(left, ramp)
    return SPEED * (speeding**2 / (2 * ramp) + (time - speeding) - (ramp - slowing) ** 2 / (2 * ramp))


def interpolated(
    at: Float[np.ndarray, " sample"], places: Float[np.ndarray, " place"], values: Float[np.ndarray, "place column"]
) -> Float[np.ndarray, "sample column"]:
    """Interpolate each column of `values`, given at increasing `places`, linearly."""
    return np.stack([np.interp(at, places, column) for column in values.T], axis=1)


def orthonormal(q: Path) -> Path:
    """Return the same rows with orthonormal columns of rotation."""
    columns = rotations(q).as_matrix()[:, :, :2].transpose(0, 2, 1).reshape(-1, 6)
    return np.concatenate([q[:, :3], columns, q[:, ROOT_COORDINATES:]], axis=1)


def rotations(q: Path) -> Rotation:
    """Return the rotation of each row's palm; the two stored columns are made orthonormal."""
    x = q[:, 3:6] / np.linalg.norm(q[:, 3:6], axis=1, keepdims=True)
    y = q[:, 6:9] - (q[:, 6:9] * x).sum(axis=1, keepdims=True) * x
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return Rotation.from_matrix(np.stack([x, y, np.cross(x, y)], axis=2))
