"""What the hand's base and fingers are told to do at every step: wait, close in, squeeze, carry the object along, stop."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation, Slerp

from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.simulation.push_model import TIMESTEP

SPEED = 0.05  # [m/s] of the base along the motion
PHASES = ("settle", "approach", "squeeze", "push", "stop")
SETTLE, APPROACH, SQUEEZE, PUSH, STOP = range(len(PHASES))
SETTLE_TIME = 0.1  # [s] in which the object comes to rest on its supports, untouched
SQUEEZE_TIME = 0.4  # [s] in which the fingers close the last 2 mm and the forces build up
RAMP_TIME = 0.1  # [s] in which the base gets to its speed, and stops
STOP_TIME = 0.1  # [s] in which the object comes to rest with the hand


@dataclass(frozen=True)
class Drive:
    """Targets per step. position [m] and quaternion (wxyz) of the palm, world; joint angles [rad]; phase: see PHASES.

    done: share of the push's way that is behind the hand.
    """

    position: Float[np.ndarray, "step 3"]
    quaternion: Float[np.ndarray, "step 4"]
    angles: Float[np.ndarray, "step angle"]
    phase: Int[np.ndarray, " step"]
    done: Float[np.ndarray, " step"]

    @property
    def velocity(self) -> Float[np.ndarray, "step 6"]:
        """Of the palm's target, linear [m/s] then angular [rad/s], world; zero at the first step."""
        rotation = Rotation.from_quat(self.quaternion, scalar_first=True)
        turned = (rotation[1:] * rotation[:-1].inv()).as_rotvec()
        linear = np.diff(self.position, axis=0)
        return np.concatenate([np.zeros((1, 6)), np.concatenate([linear, turned], axis=1) / TIMESTEP])


def push_drive(
    times: Float[np.ndarray, " sample"],
    q: Float[np.ndarray, "sample coordinates"],
    *,
    motion: Float[np.ndarray, " 3"],
    length: float,
) -> Drive:
    """The hand follows q (world) at `times` [s, from 0] up to contact, squeezes, and moves `length` [m] along `motion`.

    A single sample is a hand that starts at contact. The push takes length / SPEED + RAMP_TIME: the base speeds up and
    slows down evenly, and goes at 0.05 m/s in between.
    """
    steps = {
        SETTLE: _steps(SETTLE_TIME),
        APPROACH: _steps(float(times[-1])) if len(times) > 1 else 0,
        SQUEEZE: _steps(SQUEEZE_TIME),
        PUSH: _steps(length / SPEED + RAMP_TIME),
        STOP: _steps(STOP_TIME),
    }
    phase = np.repeat(list(steps), list(steps.values()))
    began = steps[SETTLE] * TIMESTEP
    clock = (np.arange(len(phase)) + 1) * TIMESTEP
    along = np.clip(clock - began, times[0], times[-1])
    rotation = Rotation.from_matrix(_matrices(q))
    turned = Slerp(times, rotation)(along) if len(times) > 1 else rotation[np.zeros(len(phase), dtype=int)]
    travelled = _travelled(clock - began - (steps[APPROACH] + steps[SQUEEZE]) * TIMESTEP, length)
    return Drive(
        position=interpolated(along, times, q[:, :3]) + travelled[:, None] * motion,
        quaternion=turned.as_quat(scalar_first=True),
        angles=interpolated(along, times, q[:, ROOT_COORDINATES:]),
        phase=phase,
        done=travelled / length,
    )


def _travelled(time: Float[np.ndarray, " step"], length: float) -> Float[np.ndarray, " step"]:
    """Distance [m] since the push began: even acceleration, constant speed, even deceleration."""
    ramp = min(RAMP_TIME, length / SPEED)
    whole = length / SPEED + ramp
    time = np.clip(time, 0.0, whole)
    left = whole - time
    speeding, slowing = np.minimum(time, ramp), np.minimum(left, ramp)
    return SPEED * (speeding**2 / (2 * ramp) + (time - speeding) - (ramp - slowing) ** 2 / (2 * ramp))


def _steps(seconds: float) -> int:
    return round(seconds / TIMESTEP)


def interpolated(
    at: Float[np.ndarray, " sample"], places: Float[np.ndarray, " place"], values: Float[np.ndarray, "place column"]
) -> Float[np.ndarray, "sample column"]:
    """Each column of `values`, given at rising `places`, linearly in between."""
    return np.stack([np.interp(at, places, column) for column in values.T], axis=1)


def _matrices(q: Float[np.ndarray, "sample coordinates"]) -> Float[np.ndarray, "sample 3 3"]:
    """Rotation of each sample's palm; the two stored columns are made orthonormal."""
    x = q[:, 3:6] / np.linalg.norm(q[:, 3:6], axis=1, keepdims=True)
    y = q[:, 6:9] - (q[:, 6:9] * x).sum(axis=1, keepdims=True) * x
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=2)
