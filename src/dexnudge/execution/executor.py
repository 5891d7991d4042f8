"""One configuration in physics: its way to contact, its forces, the push, the verdict."""

import copy
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError, quote
from dexnudge.execution.scene_rollout import SceneRollout
from dexnudge.execution.slide_grasp_lift import MOST_REGRASPS, Attempt, Slide
from dexnudge.mechanics.sliding_task import hardest_task, sliding_task
from dexnudge.planning.approach import Approach, ApproachPlanner
from dexnudge.planning.hand_clearance import Blocked
from dexnudge.planning.object_path import push_length, stations
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.feedback import Feedback
from dexnudge.simulation.hand_path import PUSH, push_path
from dexnudge.simulation.model import SimulationModel, changed_physics
from dexnudge.simulation.open_loop import OpenLoop
from dexnudge.simulation.policy import Policy
from dexnudge.simulation.push_forces import PushForces, forces_with_reserve
from dexnudge.simulation.rollout import Divergence, Rollout, Trace
from dexnudge.simulation.success import LEAST_ADVANCE, PushVerdict, judge_push
from dexnudge.verification.verdicts import contacts_of

MOST_APPROACHED = 5  # alternatives, to begin with, where a configuration will not do
REHEARSED_IN = {"friction_hand": 0.85, "mass": 1.15}  # times as planned: what they may well be off by
Alternatives = Float[np.ndarray, "n coordinates"] | None


@dataclass(frozen=True)
class Start:
    """What a push begins with: configuration `q`, its number as in `Execution.began_with`, the way to it, its forces."""

    number: int
    q: Float[np.ndarray, " coordinates"]
    approach: Approach | Blocked
    forces: PushForces


@dataclass(frozen=True)
class Execution:
    """The push of one configuration.

    divergence: None unless the simulation diverged. forces: with which the hand pressed. approach: of which the last,
    straight stretch is simulated; where it is blocked the hand starts at contact. seconds: wall time by stage, of which
    approach, forces and rehearsal are those of all that were tried. began_with: 0 for the configuration itself; k for the
    k-th alternative, as no free way leads to the configuration, or as it `failed_rehearsal`.
    """

    verdict: PushVerdict
    trace: Trace
    divergence: Divergence | None
    forces: PushForces
    approach: Approach | Blocked
    seconds: dict[str, float]
    began_with: int = 0
    failed_rehearsal: bool = False

    @property
    def took_hold_again(self) -> int:
        """How often the hand pushed on after its first push."""
        return len(np.unique(self.trace.attempt[self.trace.phase == PUSH])[1:])

    def number_of_first(self, number: int) -> int:
        """Return the place of what the push began with in the list of this configuration, `number`, and the alternatives."""
        return self.began_with - (self.began_with <= number) if self.began_with else number


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    """Add the wall time of what is done inside."""
    start = time.perf_counter()
    yield
    seconds[stage] += time.perf_counter() - start


def distinct_pushes(began_with: Iterable[int]) -> list[int]:
    """Return the places of the pushes to count: of those that began with the same configuration, the first."""
    first: dict[int, int] = {}
    for place, number in enumerate(began_with):
        first.setdefault(number, place)
    return list(first.values())


def chosen_policy(feedback: object) -> Policy:
    """Return the policy that is asked for: `Feedback`, the plan as it is for False, or one's own.

    Raises:
        InputError: anything else, such as a class in place of an instance.
    """
    if isinstance(feedback, bool):
        return Feedback() if feedback else OpenLoop()
    if isinstance(feedback, type) or not isinstance(feedback, Policy):
        call = "; call the class" if isinstance(feedback, type) else ""
        raise InputError(
            f"`feedback` is {quote(feedback)}; expected True, False or a policy with `start` and `command`{call}"
        )
    return feedback


class Executor:
    """Pushes the object of one scene, of which `simulation` is the model, by `push_length(scene)` with configurations q.

    policy: what decides step by step; feedback unless given.

    Raises:
        InputError: a policy that is none.
    """

    def __init__(self, scene: Scene, simulation: SimulationModel, policy: Policy | None = None) -> None:
        self._scene, self._simulation, self._hand = scene, simulation, simulation.hand
        self._policy = chosen_policy(True if policy is None else policy)
        self._length = push_length(scene)
        self._planner = ApproachPlanner(self._hand, scene)
        self._stations, self._task = stations(scene, self._length), sliding_task(scene)
        self._rehearses = scene.turn is not None  # of what only slides, the balance tells enough

    def __call__(self, q: Float[np.ndarray, " coordinates"], alternatives: Alternatives = None) -> Execution:
        """Push with q (world); the same q gives the same result, whatever was executed before.

        Where no free way leads to q, the push begins with the first of the `alternatives` to which one does. Turns and tips
        are rehearsed first, the object heavier and more slippery than it should be: the push begins with the first that
        holds then, or else with the first. An object that falls short is pushed on: with q or one of the `alternatives`,
        whichever balances best where the object lies then, or the first of those that fit where it turns. None: neither.
        """
        seconds: dict[str, float] = defaultdict(float)
        start, failed = self._first(q, alternatives, seconds)
        with _timed(seconds, "simulation"):
            rollout = self._play(self._simulation, start, alternatives)
        verdict, tried = self._judge(rollout), (start.forces, start.approach, dict(seconds), start.number, failed)
        return Execution(verdict, rollout.trace, rollout.divergence, *tried)

    def with_policy(self, policy: Policy) -> "Executor":
        """Return an executor that differs in its policy alone."""
        other = copy.copy(self)
        other._policy = chosen_policy(policy)  # noqa: SLF001 - of our own class
        return other

    def again(
        self,
        q: Float[np.ndarray, " coordinates"],
        execution: Execution,
        simulation: SimulationModel,
        alternatives: Alternatives = None,
    ) -> PushVerdict:
        """Return the verdict on the same approach and forces, played in another model of the same hand and scene.

        That model may have other frictions, of which approach and forces then know nothing.
        """
        start = Start(execution.began_with, q, execution.approach, execution.forces)
        return self._judge(self._play(simulation, start, alternatives))

    def _first(
        self, q: Float[np.ndarray, " coordinates"], alternatives: Alternatives, seconds: dict[str, float]
    ) -> tuple[Start, bool]:
        """Return what to begin with, and whether q failed a rehearsal; see `Execution`. seconds: are added to."""
        others = q[None][:0] if alternatives is None else alternatives[:MOST_APPROACHED]
        tried: list[Start] = []
        failed = False
        for number, each in enumerate([q, *others]):
            with _timed(seconds, "approach"):
                approach = self._planner.plan(each)
            if number and isinstance(approach, Blocked):
                continue
            with _timed(seconds, "forces"):
                tried.append(Start(number, each, approach, self._forces(each)))
            if isinstance(approach, Approach):
                if len(others) == 0 or self._holds(tried[-1], seconds):
                    return tried[-1], failed
                failed |= number == 0
        return next((each for each in tried if isinstance(each.approach, Approach)), tried[0]), failed

    def _holds(self, start: Start, seconds: dict[str, float]) -> bool:
        """Return whether a push without alternatives succeeds in the world of `REHEARSED_IN`, or need not be rehearsed."""
        if not self._rehearses:
            return True
        with _timed(seconds, "rehearsal"):
            return self._judge(self._play(self._harder, start, None)).success

    @cached_property
    def _harder(self) -> SimulationModel:
        return changed_physics(self._simulation, **REHEARSED_IN)

    def _forces(self, q: Float[np.ndarray, " coordinates"]) -> PushForces:
        (contacts,) = contacts_of(self._scene, self._hand, q[None])
        return forces_with_reserve(self._simulation, q, contacts, self._stations, hardest_task(self._scene))

    def _play(self, simulation: SimulationModel, start: Start, alternatives: Alternatives) -> Rollout:
        q, approach = start.q, start.approach
        times, way = approach.last_stretch if isinstance(approach, Approach) else (np.zeros(1), q[None])
        path = push_path(times, way, motion=self._scene.object_motion, length=self._length)
        rollout = Rollout(simulation, way[0])
        rollout.push(path, start.forces, self._policy)
        if isinstance(approach, Approach) and alternatives is not None:
            self._go_on(rollout, simulation, approach, np.stack([q, *alternatives]))
        return rollout

    def _go_on(
        self,
        rollout: Rollout,
        simulation: SimulationModel,
        approach: Approach,
        q: Float[np.ndarray, "n coordinates"],
    ) -> None:
        """Back off and push with one of the configurations after another until the object is there, or none fits."""
        stage = SceneRollout(self._scene, simulation, rollout)
        slide = Slide(stage, q, self._policy, length=self._left, there=self._there)
        for attempt in range(2, 2 + MOST_REGRASPS):
            if self._there(stage.scene_now()) or stage.why_over():
                return
            if attempt == 2:
                stage.back_off(approach)
                if self._there(stage.scene_now()):
                    return
            rollout.attempt = attempt
            if slide(stage.scene_now(), Attempt(attempt, "slide", Outcome.SUCCESS)).configuration < 0:
                return

    def _there(self, scene: Scene) -> bool:
        """Return whether the object in `scene` has made enough of its turn and of its slide."""
        motion, here = self._scene.object_motion, scene.object_motion
        slide_left = self._left(scene) - here.turn_length
        stages = ((here.turn_length, motion.turn_length), (slide_left, motion.slid(self._length)))
        return all(left <= (1 - LEAST_ADVANCE) * whole for left, whole in stages if whole > 0)

    def _left(self, scene: Scene) -> float:
        """Return how much of the push is left where the object is in `scene` [m], what it has to turn included.

        An object that has slid too far has nothing left to slide; it may still have to turn.
        """
        motion, moved = self._scene.object_motion, scene.T_world_object @ np.linalg.inv(self._scene.T_world_object)
        fixed = self._task.centre if motion.turn is None else motion.turn.point  # which a turn alone leaves where it is
        slid = float((moved[:3, :3] @ fixed + moved[:3, 3] - fixed) @ motion.direction)
        slide_length = motion.slid(self._length)
        return scene.object_motion.turn_length + (max(0.0, slide_length - slid) if slide_length > 0 else 0.0)

    def _judge(self, rollout: Rollout) -> PushVerdict:
        return judge_push(
            rollout.trace,
            motion=self._scene.object_motion,
            length=self._length,
            max_normal_force=self._task.max_normal_force,
            diverged=rollout.divergence is not None,
        )
