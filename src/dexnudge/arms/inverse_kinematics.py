"""Joint angles that bring an arm's flange to poses: Levenberg-Marquardt, thousands of poses and starts in one batch.

Damped in proportion to the squared error (Sugihara, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt
method", IEEE T-RO 27(5), 2011). Where reach is judged, mapped, or felt by a sampler there are thousands of poses; a library
that takes one at a time (mink: 7 ms a start) would need minutes for what is done here in a second, and from eight starts it
solves 68 % of a Panda's poses where this solves 99.8 %.
"""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from dexnudge.arms.arm import Arm

LEVER = 0.3  # [m] at which a rotation counts as a translation: from the flange to the fingertips of a hand
POSITION_TOLERANCE = 1.0e-5  # [m]
ROTATION_TOLERANCE = 1.0e-4  # [rad]
DAMPING, LEAST_DAMPING = 0.1, 1.0e-8  # [1/rad^2] of the squared error, and what is added to it [m^2/rad^2]
LARGEST_STEP = 0.5  # [rad] of any joint: the linear model holds no farther
MOST_STEPS = 40  # of one start; a start that leads anywhere takes 5 to 15
PATIENCE, LEAST_FALL = 5, 0.5  # a start is given up whose squared error has not fallen to this share in so many steps
STARTS_SEED = 20  # of the evenly spread starts; any would do


@dataclass(frozen=True)
class FlangeState:
    """Where the flange is in the frame of the arm's base, and how the joints move it.

    rotation, position [m]. jacobian: [linear velocity (3) | angular velocity (3)] of each joint, the base's axes.
    """

    rotation: Float[np.ndarray, "pose 3 3"]
    position: Float[np.ndarray, "pose 3"]
    jacobian: Float[np.ndarray, "pose 6 n"]


@dataclass(frozen=True)
class Solutions:
    """What was found for each pose.

    positions: joint angles within their limits. solved: which bring the flange to its pose. error: what is left, squared
    [m^2], rotation by `LEVER`.
    """

    positions: Float[np.ndarray, "pose n"]
    solved: Bool[np.ndarray, " pose"]
    error: Float[np.ndarray, " pose"]


class InverseKinematics:
    """Solves for the flange of one arm, where it stands."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.chain = Chain(arm)
        self._T_base_world = np.linalg.inv(arm.T_world_base)

    def solve(
        self, T_world_flange: Float[np.ndarray, "4 4"], start: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"] | None:
        """Return joint angles within their limits that bring the flange there, near `start`; None if none are found."""
        found = self.solve_all(T_world_flange[None], np.asarray(start, dtype=float)[None])
        return found.positions[0] if found.solved[0] else None

    def starts(self, count: int) -> Float[np.ndarray, "count n"]:
        """Return home and joint angles spread evenly over their range; the same every time."""
        from scipy.stats.qmc import Halton  # takes half a second

        lower, upper = self.arm.limits.lower, self.arm.limits.upper
        spread = Halton(self.arm.num_joints, rng=STARTS_SEED).random(count - 1)
        return np.concatenate([self.arm.home[None], lower + spread * (upper - lower)])

    def solve_all(
        self,
        T_world_flange: Float[np.ndarray, "pose 4 4"],
        start: Float[np.ndarray, "pose n"],
        *,
        most_steps: int = MOST_STEPS,
    ) -> Solutions:
        """Return joint angles for each pose, each from its own start; a joint that the error pushes beyond a limit rests."""
        limits, targets = self.arm.limits, self._T_base_world @ T_world_flange
        here = np.clip(start, limits.lower, limits.upper)
        best, solved = here.copy(), np.zeros(len(targets), dtype=bool)
        error, before = np.full((2, len(targets)), np.inf)
        rows = np.arange(len(targets))
        for step in range(most_steps + 1):
            now = self.chain.flange(here)
            turn = Rotation.from_matrix(targets[rows, :3, :3] @ now.rotation.swapaxes(1, 2)).as_rotvec()
            away = np.concatenate([targets[rows, :3, 3] - now.position, LEVER * turn], axis=1)
            squared = (away**2).sum(axis=1)
            better = squared < error[rows]
            best[rows[better]], error[rows[better]] = here[better], squared[better]
            largest = np.abs(away).reshape(-1, 2, 3).max(axis=2)
            solved[rows] = (largest < (POSITION_TOLERANCE, LEVER * ROTATION_TOLERANCE)).all(axis=1)
            left = ~solved[rows]
            if step % PATIENCE == 0:
                left &= error[rows] < LEAST_FALL * before[rows]
                before[rows] = error[rows]
            if step == most_steps or not left.any():
                break
            rows, here, jacobian = rows[left], here[left], now.jacobian[left]
            jacobian[:, 3:] *= LEVER
            here = np.clip(here + self._step(here, away[left], jacobian), limits.lower, limits.upper)
        return Solutions(best, solved, error)

    def _step(
        self,
        positions: Float[np.ndarray, "pose n"],
        away: Float[np.ndarray, "pose 6"],
        jacobian: Float[np.ndarray, "pose 6 n"],
    ) -> Float[np.ndarray, "pose n"]:
        limits, downhill = self.arm.limits, np.einsum("pxj,px->pj", jacobian, away)
        stuck = ((positions <= limits.lower) & (downhill < 0)) | ((positions >= limits.upper) & (downhill > 0))
        free = np.where(stuck[:, None], 0.0, jacobian)
        damping = DAMPING * (away**2).sum(axis=1) + LEAST_DAMPING
        normal = free @ free.swapaxes(1, 2) + damping[:, None, None] * np.eye(6)
        step = np.einsum("pxj,px->pj", free, np.linalg.solve(normal, away[..., None])[..., 0])
        return np.asarray(step * np.minimum(1.0, LARGEST_STEP / np.maximum(np.abs(step).max(axis=1), 1e-9))[:, None])


class Chain:
    """Forward kinematics of an arm's flange, for many joint angles at once."""

    def __init__(self, arm: Arm) -> None:
        joints = arm.chain
        moving = [place for place, joint in enumerate(joints) if not joint.fixed]
        ends = zip([0, *(place + 1 for place in moving)], [*(place + 1 for place in moving), len(joints)], strict=True)
        *origins, self._T_last_flange = (
            reduce(np.matmul, (joint.origin for joint in joints[first:last]), np.eye(4)) for first, last in ends
        )
        frame, axis = np.array(origins)[:, :3, :3], np.array([joints[place].axis for place in moving])
        self._slides = np.array([joints[place].slides for place in moving])
        self._origin, self._axis = np.array(origins)[:, :3, 3], np.einsum("jab,jb->ja", frame, axis)
        # What the joints do is factor @ joint angles + offset: some joints follow others.
        lines = [arm.lines[joints[place].name] for place in moving]
        self._offset = np.array([offset for _, _, offset in lines])
        self._factor = np.array([factor * np.eye(arm.num_joints)[index] for index, factor, _ in lines])
        # Rodrigues' formula, 1 + sin K + (1 - cos) K K, as three matrices of each joint that turns.
        cross = np.where(self._slides[:, None, None], 0.0, np.cross(np.eye(3), axis[:, None]))
        self._constant, self._sine, self._cosine = frame + frame @ cross @ cross, frame @ cross, -frame @ cross @ cross

    def flange(self, positions: Float[np.ndarray, "pose n"]) -> FlangeState:
        """Return the state of the flange at joint angles."""
        frames = self.frames(positions)
        last = frames[:, -1] @ self._T_last_flange
        before = np.concatenate([np.tile(np.eye(3), (len(frames), 1, 1, 1)), frames[:, :-1, :3, :3]], axis=1)
        axes, slides = np.einsum("pjab,jb->pja", before, self._axis), self._slides[:, None]
        linear = np.where(slides, axes, np.cross(axes, last[:, None, :3, 3] - frames[:, :, :3, 3]))
        jacobian = np.concatenate([linear, np.where(slides, 0.0, axes)], axis=2).swapaxes(1, 2)
        return FlangeState(last[:, :3, :3], last[:, :3, 3], jacobian @ self._factor)

    def frames(self, positions: Float[np.ndarray, "pose n"]) -> Float[np.ndarray, "pose moving 4 4"]:
        """Return the frame behind each of the chain's joints that move, in that of the base."""
        angles = positions @ self._factor.T + self._offset
        sine, cosine = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
        turned = self._constant + sine * self._sine + cosine * self._cosine
        shifted = self._origin + (self._slides * angles)[..., None] * self._axis
        rotation, position = np.tile(np.eye(3), (len(positions), 1, 1)), np.zeros((len(positions), 3))
        frames = np.zeros((*angles.shape, 4, 4))
        frames[..., 3, 3] = 1.0
        for joint in range(angles.shape[1]):
            position = position + np.einsum("pab,pb->pa", rotation, shifted[:, joint])
            rotation = rotation @ turned[:, joint]
            frames[:, joint, :3, :3], frames[:, joint, :3, 3] = rotation, position
        return frames
