"""The simulation of one hand in one scene, and what the hand does between pushing, grasping and lifting."""

from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.approach import OPENING_ALLOWANCE, Approach, ApproachPlanner
from dexnudge.planning.hand_clearance import CLEARANCE, HandClearance
from dexnudge.planning.hand_motion import JOINT_SPEED, palm_pose, state_space
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.motion import SMALLEST_TURN, Turn
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hand_path import along_line, along_way, bending, waiting
from dexnudge.simulation.model import SimulationModel
from dexnudge.simulation.rollout import Rollout
from dexnudge.simulation.success import LEAST_ADVANCE, MOST_SUNK
from dexnudge.verification.criteria import PENETRATION_LIMIT
from dexnudge.verification.penetration import self_penetration

FREE_SPEED = 0.10  # [m/s] of a hand that moves away, in the middle of its way
REST_TIME = 0.2  # [s] in which an object that was let go comes to rest
MOST_LEFT = 1.0 - LEAST_ADVANCE  # of a turn that may be left undone
DISTANCES = (0.0, 0.03, 0.06, 0.10, 0.15, 0.20, 0.30)  # [m] the first that is free is taken
MOST_RETREATS = 3  # of a hand that still is too near, as springs that gave way have come back
STEP = 0.002  # [m] between the places that are checked
OPENING_STEPS = 17  # openings that are checked between two sets of joint angles
LEAST_CLEARANCE = 0.0015  # [m] kept while it moves away, or what it has where it stands


class SceneRollout:
    """A rollout that begins when the hand first goes to the object; `first` is the scene as it was at the start.

    rollout: one that has begun already.
    """

    def __init__(self, first: Scene, simulation: SimulationModel, rollout: Rollout | None = None) -> None:
        self.hand, self.first, self.simulation = simulation.hand, first, simulation
        self._rollout = rollout

    @property
    def begun(self) -> bool:
        """Whether the hand has gone anywhere yet."""
        return self._rollout is not None

    @property
    def rollout(self) -> Rollout:
        """The rollout, which has begun."""
        assert self._rollout is not None
        return self._rollout

    @property
    def q(self) -> Float[np.ndarray, " coordinates"] | None:
        """Where the hand is; None where it may still come from anywhere."""
        return self.rollout.q if self.begun else None

    def scene_now(self) -> Scene:
        """Return the scene with the object where it is, and what is left of its turn: none of little before a slide."""
        if not self.begun:
            return self.first
        first, here = self.first, self.rollout.T_world_object
        turn, moved = first.turn, here @ np.linalg.inv(first.T_world_object)
        if turn is not None:
            made = float(Rotation.from_matrix(moved[:3, :3]).as_rotvec() @ turn.axis)
            left = max(min(turn.angle, turn.angle - made), SMALLEST_TURN)
            slides = first.motion_length > 0 and left <= max(MOST_LEFT * turn.angle, SMALLEST_TURN)
            turn = None if slides else Turn(left, turn.axis, (moved @ np.append(turn.point, 1.0))[:3])
        return replace(first, T_world_object=here, turn=turn)

    def model_at(self, scene: Scene) -> SimulationModel:
        """Return the model, which places the object where `scene` has it."""
        return replace(self.simulation, T_world_object=scene.T_world_object)

    def go_to_pre_contact(self, approach: Approach, *, from_outside: bool) -> Rollout:
        """Move the hand to pre-contact; a rollout that begins here begins there, or `from_outside`."""
        times, q = approach.transit
        if not self.begun:
            self._rollout = Rollout(self.simulation, q[0] if from_outside else approach.last_stretch[1][0])
            if not from_outside:
                return self.rollout
        self.rollout.follow(along_way(times, q), "transit")
        return self.rollout

    def back_off(self, approach: Approach) -> None:
        """Move along the last stretch backward, and on to where the fingers can open; farther where the hand sagged."""
        rollout = self.rollout
        times, q = approach.last_stretch
        back = q[::-1].copy()
        back[:, :3] += rollout.commanded[:3] - q[-1, :3]
        rollout.follow(along_way(times, back), "release")
        rollout.follow(waiting(rollout.commanded, seconds=REST_TIME), "release")
        for _ in range(MOST_RETREATS):
            if self.why_over():
                return
            free = retreat(self.hand, self.scene_now(), rollout.q)
            if free is None:
                self.go_out()
                return
            way, openings = free
            rollout.follow(along_line(rollout.commanded, way, speed=FREE_SPEED), "release")
            for angles in openings:
                rollout.follow(
                    bending(rollout.commanded, angles, speed=JOINT_SPEED * self.hand.joint_scales), "release"
                )
            if not way.any():
                return

    def go_out(self) -> None:
        """Leave the surroundings by a way on which the hand could have come to where it is; stay where there is none."""
        way = ApproachPlanner(self.hand, self.scene_now()).plan(self.rollout.q)
        if isinstance(way, Approach):
            times, q = way.trajectory.times, way.trajectory.q
            self.rollout.follow(along_way(times[-1] - times[::-1], q[::-1]), "release")

    def moved(self, since: Scene) -> Float[np.ndarray, " 3"]:
        """Return the displacement of the object's centre of mass since `since` [m, world]."""
        return sliding_task(self.scene_now()).centre - sliding_task(since).centre

    def why_over(self) -> Outcome | None:
        """Return why nothing further can be tried; None if it can."""
        if not self.begun:
            return Outcome.NOTHING_PLAYED
        if self.rollout.divergence:
            return Outcome.DIVERGED
        moved, motion = self.moved(self.first), self.first.motion
        sunk = float(motion[2] * (moved @ motion) - moved[2])  # a motion downhill is no sinking
        return Outcome.FELL if sunk > MOST_SUNK else None


def retreat(
    hand: Hand, scene: Scene, q: Float[np.ndarray, " coordinates"]
) -> tuple[Float[np.ndarray, " 3"], list[Float[np.ndarray, " joint"]]] | None:
    """Return how a hand that has let go withdraws: a translation [m, world], then joint angles [rad] one after another.

    It is the shortest one after which the fingers can open without touching anything or each other; None if there is none.
    Tried are up, back along the fingers, back of the hand first, along the scene's motion and against it, and the sums of
    two of them.
    """
    openings = opening_path(hand, q[ROOT_COORDINATES:])
    if openings is None:
        return None
    measure = HandClearance(hand, scene)
    room = max(0.0, min(LEAST_CLEARANCE, float(measure.shifted(q, np.zeros((1, 3))).distance.min())))
    opening = _between([q[ROOT_COORDINATES:], *openings])
    for distance in DISTANCES:
        for direction in _directions(hand, palm_pose(q), scene.motion)[: 1 if distance == 0 else None]:
            way = distance * direction
            open_there = measure.shifted(q, np.repeat(way[None], len(opening), axis=0), opening, stop=CLEARANCE)
            if open_there.distance.min() < CLEARANCE:
                continue
            shifts = np.linspace(0.0, 1.0, int(distance / STEP) + 2)[:, None] * way
            if measure.shifted(q, shifts, stop=room).distance.min() >= room:
                return way, openings
    return None


def opening_path(hand: Hand, angles: Float[np.ndarray, " joint"]) -> list[Float[np.ndarray, " joint"]] | None:
    """Return joint angles from these to the open hand; None if no clean order is found.

    The links are never more than 1 mm in one another, nor deeper than they are now: fingers that have pressed may have
    been pushed into each other a little, since contacts of the simulation's coarser pieces begin inside them.
    All digits open at once if that is clean, else one of them before the others, or after them.
    """
    opened = state_space(hand, angles).opened
    paths = [[opened]]
    for digit in hand.fingertips:
        mine = np.zeros(hand.num_joints, dtype=bool)
        for name, joint in zip(hand.link_names, hand.joints, strict=True):
            if joint is not None and joint.index is not None:
                mine[joint.index] |= hand.digit_of_link[name] == digit
        paths += [[np.where(mine, opened, angles), opened], [np.where(mine, angles, opened), opened]]
    allowed = max(PENETRATION_LIMIT, float(self_penetration(hand, angles[None])[0]) + OPENING_ALLOWANCE)
    return next((path for path in paths if self_penetration(hand, _between([angles, *path])).max() <= allowed), None)


def _between(path: list[Float[np.ndarray, " joint"]]) -> Float[np.ndarray, "n joint"]:
    """Return joint angles along a path."""
    fractions = np.linspace(0.0, 1.0, OPENING_STEPS)[:, None]
    return np.concatenate([start + fractions * (end - start) for start, end in pairwise(path)])


def _directions(
    hand: Hand, pose: Float[np.ndarray, "4 4"], motion: Float[np.ndarray, " 3"]
) -> list[Float[np.ndarray, " 3"]]:
    back = -pose[:3, :3]
    own = [np.array([0.0, 0.0, 1.0]), back @ hand.finger_axis, back @ hand.palm_normal, motion, -motion]
    sums = own + [one + two for one, two in combinations(own, 2)]
    return [total / np.linalg.norm(total) for total in sums if np.linalg.norm(total) > 0.3]
