"""A push that feels: it presses harder where the object slips, less where a link exceeds its limit, aims anew, and waits.

The plan says where the object should be at every step, as a rigid motion. What it is off by is split along the twist of that
motion, a lag in metres of way, and across it; so slides, turns and tips are treated alike.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.simulation.feedback_limits import FeedbackLimits
from dexnudge.simulation.hand_path import PUSH, SETTLE, SPEED, interpolated, stage_ends, twists
from dexnudge.simulation.model import TIMESTEP
from dexnudge.simulation.open_loop import OpenLoop, in_base
from dexnudge.simulation.policy import Command, Observation, PushPlan
from dexnudge.simulation.push_forces import PushForces

FEEL_TIME = 0.03  # [s] over which forces and speeds are smoothed: contacts chatter from one step to the next
PULL_TIME = 0.1  # [s] the same for the ratio of pull to press
STILL_TIME = 0.3  # [s] the same for whether the object moves at all
LEVER = 0.06  # [m] that makes an angle a length where errors are split: half of a phone
LEAST = 0.3  # [N] below which a link or a hand does not press
ROTATION_GAIN = 4.0  # of the base's torques over its forces: a palm's turn moves stiff fingers little
SLIPPING = 0.3  # of the hand's speed at which press rises as fast as it may


class Feedback:
    """Follows the plan, corrected by what is felt and seen.

    - **Press**: torques of the fingers and wrench of the base are scaled up while the object slips behind the palm, or while
      the base pulls more per newton of press than planned; as they come to their most, those of the reserve, for which more
      links press, take their place. They are scaled down while the object tilts. A tipped object that is pulled is pinched:
      it is pressed harder where it tilts, and the base lifts as planned.
    - **Links**: what each presses with is brought to its share, below its limit, by its fingers' torques and by the base.
    - **Way**: the target of the base leads by what its springs give way; it slows down for an object that stays behind, and
      pushes on at the end. The push ends early where the object stands still, or has turned too far.
    - **Aim**: base and fingers turn and move aside, about the object, against its error across the motion.

    Without the object's pose there is the ratio of pull to press, the links' forces and the base's lead.

    limits: of all that; see `FeedbackLimits`.
    """

    def __init__(self, limits: FeedbackLimits | None = None) -> None:
        self.limits = limits or FeedbackLimits()

    def start(self, plan: PushPlan) -> None:
        """Begin with the first step of the plan and no corrections."""
        path, forces = plan.path, plan.forces
        self._plan, self._loop = plan, OpenLoop()
        self._loop.start(plan)
        self._twist = twists(path)
        # What pinches harder must not lift more: the fingers would slip off.
        self._lifts = forces.pinches & (self._loop.wrench[:, 2] > 0)
        self._share, self._most_press = self._shares(forces)
        self._reserve = None if forces.reserve is None else self._at_most(forces.reserve)
        self._ends = stage_ends(path)
        self._beyond = np.zeros(6)  # by what the stages that are over took the hand beyond the plan [m, rad]
        self._clock, self._rate, self._waited = 0.0, 1.0, 0.0  # step of the plan, its pace, [s]
        self._last = len(path.phase) - 1  # step of the plan at which the hand stays
        self._start: Float[np.ndarray, "4 4"] | None = None  # pose of the object before the push
        self._press, self._slip, self._slipping, self._pull = 1.0, 0.0, 0.0, 0.0
        self._lead, self._further = 0.0, 0.0  # of the base's target [m of way]: for its springs, and at the end
        self._way, self._moving, self._off, self._over = 0.0, 1.0, 0.0, False
        self._aim, self._wrench = np.zeros((2, 6))
        self._force, self._extra = np.zeros((2, forces.link_force.shape[1]))

    def _shares(self, forces: PushForces) -> tuple[Float[np.ndarray, "step link"], Float[np.ndarray, " step"]]:
        """Return the planned force of each link [N], and how many times that may be, step by step."""
        share = interpolated(self._plan.path.done, forces.done, forces.link_force)
        room = self.limits.room * forces.limit / np.maximum(share.max(axis=1), LEAST)
        return share, np.clip(room, 1.0, self.limits.press[1])

    def _at_most(self, reserve: PushForces) -> tuple[Float[np.ndarray, "step column"], ...]:
        """Return what `_pressed` does, at every step, for a reserve that presses as hard as it may."""
        share, press = self._shares(reserve)
        loop = OpenLoop()
        loop.start(replace(self._plan, forces=reserve))
        return tuple(press[:, None] * each for each in (share, loop.torque, loop.wrench))

    def _pressed(self, step: int) -> tuple[Float[np.ndarray, " column"], ...]:
        """Return forces of links [N], torques of motors and wrench of the base at a step: what is planned, times the press.

        As the press rises to its most, those of the reserve take their place.
        """
        planned = [self._press * each[step] for each in (self._share, self._loop.torque, self._loop.wrench)]
        if self._reserve is None or self._press <= 1.0:
            return tuple(planned)
        over = min(1.0, (self._press - 1.0) / max(self._most_press[step] - 1.0, 1e-6))
        return tuple((1.0 - over) * one + over * other[step] for one, other in zip(planned, self._reserve, strict=True))

    def command(self, seen: Observation) -> Command | None:
        """Return the plan's step, corrected; None when the push is over."""
        path, step = self._plan.path, int(self._clock)
        if step >= len(path.phase):
            return None
        if path.phase[step] == SETTLE or self._start is None:
            self._start = seen.T_world_object
        self._force += TIMESTEP / FEEL_TIME * (seen.link_force - self._force)
        place = min(step, self._last)
        told = self._loop.at(place, seen, rate=self._rate if place == step else 0.0)
        told = told._replace(phase=str(path.phase[step]))
        self._rate = 1.0
        if path.phase[step] == PUSH:
            lag, across = self._error(seen, step)
            behind = self._behind(seen, told, step)
            self._feel(seen, step, lag - behind)
            self._press_anew(step, tilt=float(np.linalg.norm(across[3:5])))
            self._lead += TIMESTEP / self.limits.track_time * (behind + self._further)
            self._lead = float(np.clip(self._lead, *self.limits.tracked))
            self._aim_anew(step, lag, across)
            self._pace(step, lag)
        else:
            self._clock += 1
        if self._loop.loaded(place) > 0:
            self._share_out(place)
        return self._corrected(told, place)

    def _error(self, seen: Observation, step: int) -> tuple[float, Float[np.ndarray, " 6"]]:
        """Return by how much of the way the object lags [m], and what it is off by across the motion [m, rad]."""
        if seen.T_world_object is None or self._start is None:
            return 0.0, np.zeros(6)
        planned, twist = self._plan.path.displacement[step] @ self._start, self._twist[step]
        twist = np.concatenate([twist[:3] + np.cross(twist[3:], planned[:3, 3]), twist[3:]])
        turned = Rotation.from_matrix(planned[:3, :3] @ seen.T_world_object[:3, :3].T).as_rotvec()
        error = np.concatenate([planned[:3, 3] - seen.T_world_object[:3, 3], turned])
        weighted = twist * np.repeat([1.0, LEVER**2], 3)
        lag = float(error @ weighted / (twist @ weighted))
        return lag, error - lag * twist

    def _behind(self, seen: Observation, told: Command, step: int) -> float:
        """Return by how much of the way the palm lags behind the plan [m]."""
        twist = self._twist[step]
        velocity = twist[:3] + np.cross(twist[3:], told.q[:3])
        return float((told.q[:3] - seen.T_world_palm[:3, 3]) @ velocity / max(velocity @ velocity, 1e-6))

    def _feel(self, seen: Observation, step: int, slip: float) -> None:
        """Take in how fast the object slips, and the ratio of pull to press."""
        speed = np.clip((slip - self._slip) / TIMESTEP / SPEED, -2.0, 2.0)
        self._slipping += TIMESTEP / FEEL_TIME * (speed - self._slipping)
        self._slip = slip if seen.T_world_object is not None else 0.0
        pull = self._along(seen.base_wrench, seen.T_world_palm[:3, 3], step) / max(float(self._force.sum()), LEAST)
        self._pull += TIMESTEP / PULL_TIME * (pull - self._pull)

    def _along(self, wrench: Float[np.ndarray, " 6"], palm: Float[np.ndarray, " 3"], step: int) -> float:
        """Return the power of a wrench about the palm's origin per metre of way [N]."""
        twist = self._twist[step]
        return float(wrench[:3] @ (twist[:3] + np.cross(twist[3:], palm)) + wrench[3:] @ twist[3:])

    def _press_anew(self, step: int, *, tilt: float) -> None:
        limits, path = self.limits, self._plan.path
        planned = self._along(self._loop.wrench[step], path.position[step], step) / max(self._share[step].sum(), LEAST)
        more = self._slipping / SLIPPING if self._slip > limits.slip else 0.0
        if planned > 0:
            more = max(more, 4.0 * (self._pull / (limits.pull * planned) - 1.0))
        if self._plan.forces.pinches and tilt > limits.tilt:  # out of its grip
            more = 1.0
        rate = limits.press_rate * min(more, 1.0) if more > 0 else -limits.relax_rate
        least = 1.0 if self._press >= 1.0 else limits.press[0]
        if self._over:
            rate, least = 0.0, limits.press[0]
        if not self._plan.forces.pinches and tilt > limits.tilt:
            rate, least = -2.0 * limits.press_rate, limits.press[0]
        self._press = float(np.clip(self._press + TIMESTEP * rate, least, self._most_press[step]))

    def _aim_anew(self, step: int, lag: float, across: Float[np.ndarray, " 6"]) -> None:
        """Turn and move aside as the object advances; where it stands still, that would only twist the fingers."""
        path, limits = self._plan.path, self.limits
        way = path.done[step] * path.length - lag
        advance = min(max(0.0, way - self._way), 2 * SPEED * TIMESTEP)  # where a stage ends, lag leaps
        self._way = max(self._way, way)
        self._moving += TIMESTEP / STILL_TIME * (advance / (SPEED * TIMESTEP) - self._moving)
        self._off = float(np.linalg.norm(across[3:]))
        if not self._plan.forces.pinches:  # turned against what stands beside it, it wedges
            self._aim += advance / limits.aim_way * across
        for part, most in ((slice(0, 3), limits.aside), (slice(3, 6), limits.turned)):
            self._aim[part] *= min(1.0, most / max(float(np.linalg.norm(self._aim[part])), most))

    def _pace(self, step: int, lag: float) -> None:
        """Go on with the plan, slower where the object stays behind; at its end push on until the object is there."""
        limits, length = self.limits, self._plan.path.length
        stuck, end = self._slip > limits.lost and self._moving < 0.05, self._ends[0]
        given_up = len(self._ends) > 1 and self._grip(step) < limits.grip  # later it would fall, not swing back
        if stuck or self._off > limits.most_off or given_up:
            # The end of the plan may be far: a target there would tear at the object.
            self._clock, self._last = self._ends[-1] + 1, step
        elif step < end:
            pressing = self._press < self._most_press[step] or self._slipping > 0.5
            if pressing and self._waited < limits.longest_wait:
                waiting = float(np.clip(self._slip / limits.slip - 1.5, 0.0, 1.0))
                self._rate = 1.0 - (1.0 - limits.slowest) * waiting
                self._waited += (1.0 - self._rate) * TIMESTEP
            self._clock = min(self._clock + self._rate, float(end))
        elif lag < limits.close or self._further >= limits.most_ahead[0] + limits.most_ahead[1] * length:
            self._clock += 1
            if len(self._ends) > 1:
                self._ends = self._ends[1:]
                self._beyond += self._ahead(step)
                self._lead = self._further = 0.0
        else:
            self._rate = 0.0
            self._further += TIMESTEP * SPEED * min(1.0, lag / (2 * limits.close))

    def _grip(self, step: int) -> float:
        """Return the share of what the links should pinch the object with that they do; 1 where it is not pinched."""
        share = self._share[step]
        return float(np.minimum(self._force, share).sum() / share.sum()) if self._plan.forces.pinches else 1.0

    def _share_out(self, step: int) -> None:
        """Bring what the links press with to what they should, by the torques of their fingers and by the base's wrench."""
        limits, forces = self.limits, self._plan.forces
        most = limits.room * forces.limit
        self._over = bool(self._force.max() > limits.most * forces.limit)
        if self._over:
            self._press = max(limits.press[0], self._press - TIMESTEP * limits.over * limits.press_rate)
        wanted = self._loop.loaded(step) * np.minimum(self._pressed(step)[0], most)
        off = wanted - self._force
        off = np.sign(off) * np.maximum(np.abs(off) - limits.band * np.maximum(wanted, 1.0), 0.0)
        off = np.where(self._share[step] > LEAST / 6, off, np.minimum(0.0, most - self._force))
        off = np.where(self._force > most, limits.over, 1.0) * off
        self._extra += TIMESTEP * (off / limits.link_time - self._extra / limits.leak)
        self._extra = np.clip(self._extra, -wanted, most)
        if forces.pinches:  # a base that presses for fingers that pinch drives the object into what carries it
            return
        change = self._carried(step, off @ forces.link_wrench) * np.repeat([1.0, ROTATION_GAIN], 3)
        self._wrench += TIMESTEP * (change / limits.base_time - self._wrench / limits.leak)
        bound = np.repeat([limits.base_force, limits.base_torque], 3)
        self._wrench = np.clip(self._wrench, -bound, bound)

    def _carried(self, step: int, wrench: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 6"]:
        """Turn a wrench from the axes in which forces are planned to the world's."""
        return (wrench.reshape(2, 3) @ self._plan.path.displacement[step, :3, :3].T).ravel()

    def _corrected(self, told: Command, step: int) -> Command:
        drive, forces = self._plan.drive, self._plan.forces
        loaded, (_, torque, wrench) = self._loop.loaded(step), self._pressed(step)
        torque = loaded * (torque - self._loop.torque[step]) + self._extra @ forces.link_torque
        ctrl = np.clip(told.ctrl + torque / drive.motor_gain, drive.lower, drive.upper)
        target = Rotation.from_quat(told.quaternion, scalar_first=True)
        more = 0.0 if self._lifts[step] else loaded * (wrench - self._loop.wrench[step])
        added = in_base(target.inv(), (more + self._wrench)[None])[0]
        ctrl[drive.base_motor] = told.ctrl[drive.base_motor] + added / drive.base_stiffness
        off = self._aim + self._beyond + self._ahead(step)
        pivot, turn = self._pivot(step), Rotation.from_rotvec(off[3:])
        rotation, q = turn * target, told.q.copy()
        q[:3] = pivot + turn.apply(told.q[:3] - pivot) + off[:3]
        q[3:9] = rotation.as_matrix()[:, :2].T.ravel()
        return Command(q, rotation.as_quat(scalar_first=True), ctrl, told.phase)

    def _pivot(self, step: int) -> Float[np.ndarray, " 3"]:
        """Return where the object should be at a step, or the base where the object is not seen [m]."""
        path = self._plan.path
        return path.position[step] if self._start is None else (path.displacement[step] @ self._start)[:3, 3]

    def _ahead(self, step: int) -> Float[np.ndarray, " 6"]:
        """Return by what the target of the base leads: a shift [m], and a turn about the pivot [rad]."""
        twist = self._twist[step]
        linear = twist[:3] + np.cross(twist[3:], self._pivot(step))
        return (self._lead + self._further) * np.concatenate([linear, twist[3:]])
