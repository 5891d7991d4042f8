"""A push as it was planned, whatever comes of it: the baseline of what feels."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.simulation.hand_path import LEAST_TURNING, SQUEEZE, interpolated, twists
from dexnudge.simulation.model import TIMESTEP
from dexnudge.simulation.policy import Command, Observation, PushPlan

TOUCHING, LOADED = 0.3, 0.8  # of the time of the squeeze: fingers have closed, forces are built up; the rest settles
FOLLOW_TIME = 0.05  # [s] in which the base's target goes down or up to where the pressing hand has come to rest
MOST_FOLLOWED = 0.005  # [m]


class OpenLoop:
    """Follows the plan step by step.

    Pressing, the base is told a force and no height: as fingers give way the hand sinks, and a target that stayed would
    pull it up by as much as it should press. So the target's height follows, by up to 5 mm. Not that of a pinch: its height
    is what keeps a tipped object at its tilt. While a pinch closes it follows along the axis of the tip instead, so that it
    comes to press from both sides.
    """

    def start(self, plan: PushPlan) -> None:
        """Begin with the first step of the plan."""
        path, forces, drive = plan.path, plan.forces, plan.drive
        self.plan, self._step = plan, 0
        self._place = path.angles @ drive.motor_of_angle.T
        squeezing = np.flatnonzero(path.phase == SQUEEZE)
        done = (np.arange(len(path.phase)) - squeezing[0] + 1) / len(squeezing)
        self._closed = np.clip(done / TOUCHING, 0.0, 1.0)
        self._loaded = np.clip((done - TOUCHING) / (LOADED - TOUCHING), 0.0, 1.0)
        rotation = Rotation.from_quat(path.quaternion, scalar_first=True)
        self._columns = rotation.as_matrix()[:, :, :2].transpose(0, 2, 1).reshape(-1, 6)
        to_base = rotation.inv()
        self._moving = in_base(to_base, drive.base_damping * path.velocity) / drive.base_stiffness
        self._carried = path.displacement[:, :3, :3]
        wrench = interpolated(path.done, forces.done, forces.base_wrench).reshape(-1, 2, 3)
        self.wrench = np.einsum("sxy,sky->skx", self._carried, wrench).reshape(-1, 6)
        self._pressing = in_base(to_base, self.wrench) / drive.base_stiffness
        self.torque = interpolated(path.done, forces.done, forces.motor_torque)
        axis = twists(path)[0, 3:] if forces.pinches else np.array([0.0, 0.0, 1.0])
        self._yields, self._followed = axis / max(float(np.linalg.norm(axis)), LEAST_TURNING), 0.0

    def command(self, seen: Observation) -> Command | None:
        """Return the next step of the plan."""
        if self._step == len(self.plan.path.phase):
            return None
        self._step += 1
        return self.at(self._step - 1, seen)

    def loaded(self, step: int) -> float:
        """Return the share of its forces with which the hand presses at a step."""
        return float(self._loaded[step])

    def at(self, step: int, seen: Observation, *, rate: float = 1.0) -> Command:
        """Return what the plan has for a step, gone through at `rate` times its pace."""
        path, forces, drive = self.plan.path, self.plan.forces, self.plan.drive
        closed, loaded = self._closed[step], self._loaded[step]
        position = path.position[step] + closed * (self._carried[step] @ forces.base_closing)
        if loaded > 0 and (not forces.pinches or path.phase[step] == SQUEEZE):
            sunk = self._yields @ (seen.T_world_palm[:3, 3] - position)
            self._followed += TIMESTEP / FOLLOW_TIME * (sunk - self._followed)
            self._followed = float(np.clip(self._followed, -MOST_FOLLOWED, MOST_FOLLOWED))
        position += self._followed * self._yields
        offset = closed * forces.closing + loaded * self.torque[step] / drive.motor_gain
        ctrl = np.clip(self._place[step] + offset, drive.lower, drive.upper)
        ctrl[drive.base_motor] = rate * self._moving[step] + loaded * self._pressing[step]
        q = np.concatenate([position, self._columns[step], path.angles[step]])
        return Command(q, path.quaternion[step], ctrl, str(path.phase[step]))


def in_base(to_base: Rotation, wrench: Float[np.ndarray, "step 6"]) -> Float[np.ndarray, "step 6"]:
    """Turn force and torque per step from the world's axes to those of the base's target."""
    return np.concatenate([to_base.apply(wrench[:, :3]), to_base.apply(wrench[:, 3:])], axis=1)
