"""The second act: grasp the object where it lies, lift it and hold it."""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.execution.grasp_finder import Grasp, GraspFinder
from dexnudge.execution.scene_rollout import SceneRollout
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_points import surface_points
from dexnudge.geometry.transforms import transform_configurations
from dexnudge.hands.hand import Hand
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.approach import Approach, ApproachPlanner
from dexnudge.planning.hand_clearance import HandClearance
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hand_path import along_line, along_way, waiting
from dexnudge.simulation.hold import squeeze

OUTWARD = tuple(np.arange(0.0, 0.401, 0.04))  # [m] along the motion before the lift, the least first
RAISE = 0.004  # [m] off the support before it moves outward: the springs of the base give way by 1.5 mm
STEP = 0.005  # [m] between the places that are looked at
SPACING = 0.005  # [m] between the points of the object
ROOM = 0.001  # [m] that hand and object keep on the way, or what they have at its start
ALLOWANCE = 0.0005  # [m] less than at the start: rounding and what contacts yield


class LiftWay:
    """Finds ways up for one hand that holds the object of one scene."""

    def __init__(self, hand: Hand, scene: Scene, *, height: float) -> None:
        self._scene, self._height = scene, height
        self._hand = HandClearance(hand, scene)
        self._environment = ExactDistance(scene.environment_mesh)
        self._points = surface_points(scene.object_in_world(), spacing=SPACING).points

    def __call__(self, q: Float[np.ndarray, " coordinates"]) -> list[Float[np.ndarray, " 3"]] | None:
        """Return translations [m, world] one after another, `height` up in all, outward as little as need be, or None."""
        up = np.array([0.0, 0.0, 1.0])
        for outward in OUTWARD:
            ways = [self._height * up]
            if outward > 0:
                ways = [RAISE * up, outward * self._scene.motion, (self._height - RAISE) * up]
            if self._free(q, ways):
                return ways
        return None

    def _free(self, q: np.ndarray, ways: list[np.ndarray]) -> bool:
        shifts, start = [np.zeros(3)], np.zeros(3)
        for way in ways:
            count = int(np.ceil(np.linalg.norm(way) / STEP))
            shifts += [start + way * step / count for step in range(1, count + 1)]
            start = start + way
        hand = self._hand.shifted(q, np.array(shifts)).distance[:, 0]
        if (hand < min(ROOM, hand[0] - ALLOWANCE)).any():
            return False
        distances = (float(self._environment(self._points + shift).distance.min()) for shift in shifts)
        least = min(ROOM, next(distances) - ALLOWANCE)
        return all(distance >= least for distance in distances)


LIFT_PHASES = ("reach", "close", "lift", "hold", "lower")
LIFT = 0.10  # [m]
LIFT_SPEED = 0.10  # [m/s] in the middle of the lift
HOLD_TIME = 2.0  # [s]
SQUEEZE_SHARE = 0.75  # of the hand's friction that the squeeze's forces use: 0.6 of 0.8, as in the hold test
MOST_PLANNED = 6  # grasps that are planned for until one has a way
GRASP_BATCHES = 3  # of draws until one holds


@dataclass(frozen=True)
class ChosenGrasp:
    """A grasp with the way there and the translations [m, world] by which it is lifted."""

    grasp: Grasp
    approach: Approach
    ways: list[Float[np.ndarray, " 3"]]


@dataclass(frozen=True)
class NoGrasp:
    """No grasp could be tried; phase: "grasp search" or "approach". detail: what `outcome` leaves open, for people."""

    phase: str
    outcome: Outcome
    detail: str


class GraspAndLift:
    """Grasps and lifts the object of a stage; no grasp is tried twice, nor planned for where no way was found.

    Attributes:
        found: grasps that are known to hold and have not been tried.
        drawn: draws so far.
    """

    def __init__(self, stage: SceneRollout, finder: GraspFinder, *, draws: int, seed: int) -> None:
        self._stage, self._finder, self._draws, self._seed = stage, finder, draws, seed
        self.found: list[Grasp] = []
        self.drawn = 0
        self._blocked = 0

    def choose(self, scene: Scene) -> ChosenGrasp | NoGrasp:
        """Return the best grasp that the hand can reach from where it is, and lift; draw some where none is known."""
        self.found = self._finder.still_clean(scene, self.found)
        rejected: Counter[str] = Counter()
        for _ in range(GRASP_BATCHES):
            if self.found:
                break
            self.found, rejected = self._finder.find(scene, num=self._draws, seed=self._seed + self.drawn)
            self.drawn += self._draws
        if not self.found:
            text = ", ".join(f"{reason} {count}" for reason, count in rejected.most_common())
            detail = f"in {self.drawn} draws; of the last {self._draws}: {text}"
            return NoGrasp("grasp search", Outcome.NO_GRASP, detail)
        planner, up = ApproachPlanner(self._stage.hand, scene), LiftWay(self._stage.hand, scene, height=LIFT)
        reasons = []
        for grasp in self.found[:MOST_PLANNED]:
            q = np.asarray(transform_configurations(scene.T_world_object, grasp.q[None])[0])
            ways = up(q)
            if ways is None:
                reasons.append("no free way up or out")
                continue
            approach = planner.plan(q, start=self._stage.q, seed=self._blocked)
            if isinstance(approach, Approach):
                return ChosenGrasp(grasp, approach, ways)
            reasons.append(f"{approach.stage}: {approach.reason}")
        self.found, self._blocked = self.found[MOST_PLANNED:], self._blocked + 1
        return NoGrasp("approach", Outcome.APPROACH_BLOCKED, f"for {len(reasons)} grasps; the best: {reasons[0]}")

    def lift(self, scene: Scene, chosen: ChosenGrasp) -> None:
        """Go there, close, lift, hold."""
        self.found = [other for other in self.found if other is not chosen.grasp]
        rollout = self._stage.go_to_pre_contact(chosen.approach, from_outside=True)
        times, q = chosen.approach.last_stretch
        rollout.follow(along_way(times, q), "reach")
        contacts = chosen.grasp.contacts.moved(scene.T_world_object)
        half_length = sliding_task(scene).half_length
        with rollout.elsewhere():
            model = self._stage.model_at(scene)
            model.place(q[-1])
            friction = SQUEEZE_SHARE * scene.friction_hand
            _, torque = squeeze(model, contacts, half_length=half_length, friction=friction)
        rollout.close(torque, "close")
        for way in chosen.ways:
            rollout.follow(along_line(rollout.commanded, way, speed=LIFT_SPEED), "lift")
        rollout.follow(waiting(rollout.commanded, seconds=HOLD_TIME), "hold")

    def put_back(self, chosen: ChosenGrasp) -> None:
        """Lower the object, let go, and back off."""
        rollout = self._stage.rollout
        for way in reversed(chosen.ways):
            rollout.follow(along_line(rollout.commanded, -way, speed=LIFT_SPEED), "lower")
        rollout.let_go()
        self._stage.back_off(chosen.approach)
