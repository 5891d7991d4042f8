"""Slide, grasp, lift: an object that cannot be grasped where it lies is pushed to where it can, grasped, and lifted.

One continuous simulation. When something fails, the next attempt goes on from where hand and object are then, as a robot
would: with the next configuration where the object still has to slide, else with the next grasp.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError
from dexnudge.execution.grasp_and_lift import LIFT, GraspAndLift, GraspFinder, NoGrasp
from dexnudge.execution.scene_rollout import SceneRollout
from dexnudge.geometry.transforms import transform_configurations
from dexnudge.mechanics.fast_balance import force_margins
from dexnudge.mechanics.sliding_task import hardest_task
from dexnudge.planning.approach import Approach, ApproachPlanner
from dexnudge.planning.object_path import DEFAULT_LIMITS, GraspableLimits, plan_object_motion, stations, stays_flat
from dexnudge.planning.outcomes import Outcome
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.feedback import Feedback
from dexnudge.simulation.hand_path import push_path
from dexnudge.simulation.hold import LiftRehearsal
from dexnudge.simulation.model import SimulationModel
from dexnudge.simulation.policy import Policy
from dexnudge.simulation.push_forces import forces_with_reserve
from dexnudge.simulation.rollout import Divergence, Trace
from dexnudge.simulation.success import (
    FORCE_TOLERANCE,
    MOST_PENETRATION,
    MOST_TURNED,
    judge_lift,
    lasting_forces,
)
from dexnudge.verification.verdicts import contacts_of, verify

GRASP_DRAWS = 32  # of grasps at a time, unless told otherwise
AIM = GraspableLimits(overhang=(0.40, 0.45), balance=0.008)  # of the slide, which may fall short or go too far
WIDE = GraspableLimits(overhang=(0.20, 0.90))  # of objects that come free by more at once
REACHED = replace(WIDE, balance=0.0)  # after it: far enough to look for grasps; what would tip has tipped
MOST_PLANNED = 6  # configurations that are planned for until one has a way
MOST_REGRASPS = 7  # of a push or slide that falls short
LEAST_ON = 0.005  # [m] that an object is slid on of which no grasp was found
UNGRASPED = ("grasp search", "approach")  # phases in which an attempt ends before a grasp


@dataclass(frozen=True)
class Attempt:
    """One attempt; None or -1 stands for what it did not come to.

    phase: in which it failed, of "slide", "grasp search", "approach", "lift", "hold"; "" where the object was lifted and
    held. outcome: how it ended. detail: what `outcome` leaves open, for people. configuration: place of the one that slid
    the object among those given; -1 where it lay graspable already. overhang: free share of the object's length after the
    slide. grasps: found, of `drawn` draws so far. drift: of the grasp taken. length_asked, length_reached [m]: of the slide.
    slide_force: greatest normal force of a link on the object in the slide [N], mean over 0.1 s.
    raised, least_held [m], turned_deg, hand_environment [m], link_force [N]: see `LiftVerdict`.
    """

    number: int
    phase: str
    outcome: Outcome
    detail: str = ""
    configuration: int = -1
    overhang: float | None = None
    length_asked: float | None = None
    length_reached: float | None = None
    slide_force: float | None = None
    grasps: int = -1
    drawn: int = -1
    drift: float | None = None
    raised: float | None = None
    least_held: float | None = None
    turned_deg: float | None = None
    hand_environment: float | None = None
    link_force: float | None = None

    @property
    def success(self) -> bool:
        """Lifted and held."""
        return self.outcome is Outcome.SUCCESS


def overhang(scene: Scene) -> float | tuple[Outcome, str]:
    """Return the free share of the object's length if it is graspable where it lies, else why it is not, and in detail."""
    plan = plan_object_motion(scene, REACHED)
    if isinstance(plan, Outcome):
        return plan, ""
    if plan.length > 0.0:
        return Outcome.STOPPED_SHORT, f"{1e3 * plan.length:.0f} mm short of {REACHED.overhang[0]:.0%} overhang"
    return plan.overhang


def to_be_graspable(scene: Scene) -> float | Outcome:
    """Return the way of the object until it can be grasped [m], what it has to turn included, or why there is none."""
    turn_length = scene.object_motion.turn_length
    turned = scene.carried(turn_length) if scene.turn else scene
    for limits in (AIM, DEFAULT_LIMITS, WIDE):
        plan = plan_object_motion(turned, limits)
        if not isinstance(plan, Outcome):
            break
    return plan if isinstance(plan, Outcome) else turn_length + plan.length


def _may_go_on(scene: Scene) -> bool:
    """Return whether the object can go farther and is graspable there, too."""
    length = to_be_graspable(scene)
    return not isinstance(length, Outcome) and length > LEAST_ON


def check_slides_at_last(scene: Scene) -> None:
    """Refuse a motion after which there is nothing to grasp: one that ends with a turn, or tips the object.

    Raises:
        InputError: saying so, and what to do.
    """
    if scene.turn is not None and not (scene.motion_length > 0 and stays_flat(scene)):
        raise InputError(
            f"the motion of '{scene.name}' ends with a turn, or tips the object; expected one that slides it, flat on its "
            "support, to where it can be grasped; give a `motion_length`, or leave out `then_grasp`"
        )


class Slide:
    """Slides the object of a stage along the scene's motion with configurations q, in their order.

    Each of them slides it once from where the hand has begun already; the one with which it begins may do so once more.

    policy: what decides step by step; feedback unless given. length: how far to push [m] in a scene, or why not; to where
    the object can be grasped unless given. there: whether the object is where the hand need not let go of it; nowhere unless
    given.
    """

    def __init__(
        self,
        stage: SceneRollout,
        q: Float[np.ndarray, "n coordinates"],
        policy: Policy | None = None,
        *,
        length: Callable[[Scene], float | Outcome] | None = None,
        there: Callable[[Scene], bool] = lambda _: False,
    ) -> None:
        self._policy, self._length, self._there = policy or Feedback(), length or to_be_graspable, there
        self._stage, self._waiting = stage, dict(enumerate(np.asarray(q, dtype=np.float64)))

    def __call__(self, scene: Scene, attempt: Attempt) -> Attempt:
        """Push the object from where it lies in `scene`; return the attempt with what came of it.

        What the scene turns is turned first, and slides from where it lies then.
        """
        length, turn_length = self._length(scene), scene.object_motion.turn_length
        if isinstance(length, Outcome):
            return replace(attempt, outcome=length)
        turned = scene.carried(turn_length) if scene.turn else scene
        chosen = self._choose(scene, length)
        if len(chosen) == 2:
            return replace(attempt, outcome=chosen[0], detail=chosen[1])
        index, q, approach = chosen
        if self._stage.begun:
            del self._waiting[index]
        rollout = self._stage.go_to_pre_contact(approach, from_outside=False)
        (contacts,) = contacts_of(scene, self._stage.hand, q[None])
        task = hardest_task(scene)
        with rollout.elsewhere():
            forces = forces_with_reserve(self._stage.model_at(scene), q, contacts, stations(scene, length), task)
        rollout.push(push_path(*approach.last_stretch, motion=scene.object_motion, length=length), forces, self._policy)
        if not self._there(self._stage.scene_now()):
            self._stage.back_off(approach)
        outcome, detail, force = self._judged(scene)
        return replace(
            attempt,
            outcome=outcome,
            detail=detail,
            configuration=index,
            length_asked=length - turn_length,
            length_reached=float(self._stage.moved(turned) @ scene.motion),
            slide_force=force,
        )

    def _choose(self, scene: Scene, length: float) -> tuple[int, np.ndarray, Approach] | tuple[Outcome, str]:
        """Return the first configuration that fits the object where it lies now, its q and a way there, or why none does.

        Once the hand has begun, each may go where it has come to with the object, or where it was drawn, under which the
        object has slid away; those come first that balance best from here to the end, or in their order where it turns.
        """
        moved = scene.T_world_object @ np.linalg.inv(self._stage.first.T_world_object)
        waiting = [(index, transform_configurations(moved, q[None])[0]) for index, q in self._waiting.items()]
        if self._stage.begun and waiting:
            waiting += list(self._waiting.items())
            if scene.turn is None:
                least = self._least_margins(scene, length, np.array([q for _, q in waiting]))
                waiting = [waiting[place] for place in np.argsort(-least, kind="stable")]
        planner = ApproachPlanner(self._stage.hand, scene)
        failed = Outcome.NO_CONFIGURATION, ""
        planned = 0
        for index, q in waiting:
            if planned == MOST_PLANNED:
                break
            if self._stage.begun:
                verdict = verify(scene, self._stage.hand, q[None])
                if not verdict.success[0]:
                    failed = Outcome.NO_LONGER_FITS, f"configuration {index}: {verdict.reasons[0]}"
                    continue
            approach, planned = planner.plan(q, start=self._stage.q), planned + 1
            if isinstance(approach, Approach):
                return index, q, approach
            failed = Outcome.APPROACH_BLOCKED, approach.reason
        return failed

    def _least_margins(
        self, scene: Scene, length: float, q: Float[np.ndarray, "n coordinates"]
    ) -> Float[np.ndarray, " n"]:
        """Return the least force margin of each configuration at both ends of the way."""
        contacts, task, way = contacts_of(scene, self._stage.hand, q), hardest_task(scene), stations(scene, length)
        found = [
            force_margins([each.moved(end.T) for each in contacts], end.supports, end.task(task)).factor[:, 0]
            for end in (way[0], way[-1])
        ]
        return np.min(found, axis=0)

    def _judged(self, before: Scene) -> tuple[Outcome, str, float]:
        """Return how the slide ended, in detail, and the greatest lasting force of a link [N]."""
        rollout = self._stage.rollout
        trace, turned = rollout.trace, rollout.T_world_object @ np.linalg.inv(before.T_world_object)
        mine = trace.attempt == rollout.attempt
        force = float(lasting_forces(trace.time[mine], trace.link_force[mine]).max())
        depth = trace.hand_environment_depth[mine].max()
        tilt = np.degrees(np.arccos(np.clip(turned[2, 2], -1.0, 1.0)))
        over = self._stage.why_over()
        if over:
            return over, "", force
        if tilt > MOST_TURNED:
            return Outcome.TIPPED, f"by {tilt:.0f} deg", force
        if depth > MOST_PENETRATION:
            return Outcome.HAND_IN_ENVIRONMENT, f"{1e3 * depth:.1f} mm", force
        if force > FORCE_TOLERANCE * before.max_normal_force:
            return Outcome.PRESSED_TOO_HARD, f"{force:.1f} N", force
        return Outcome.SUCCESS, "", force


@dataclass(frozen=True)
class SlideGraspLiftResult:
    """All attempts, at least one, and the trace of the whole simulation; None where nothing could be played.

    ended: why there were no more attempts; None for success or because their number was reached.
    """

    attempts: list[Attempt]
    trace: Trace | None
    ended: Outcome | None
    divergence: Divergence | None


class SlideGraspLift:
    """Slides, grasps and lifts the object of one scene, of which `simulation` is the model.

    The scene's motion may turn the object first, flat on its support. q are configurations that were sampled for it, in the
    order in which they are to be tried. Grasps are
    drawn by `sampler`, made for the same hand, `draws` at a time, from `seed` on.
    """

    def __init__(
        self,
        scene: Scene,
        simulation: SimulationModel,
        q: Float[np.ndarray, "n coordinates"],
        sampler: Sampler,
        *,
        draws: int = GRASP_DRAWS,
        seed: int,
        policy: Policy | None = None,
    ) -> None:
        check_slides_at_last(scene)
        self._stage = SceneRollout(scene, simulation)
        finder = GraspFinder(simulation.hand, sampler, scene, LiftRehearsal(simulation, scene))
        self._slide = Slide(self._stage, q, policy)
        self._grasp = GraspAndLift(self._stage, finder, draws=draws, seed=seed)

    def run(self, most_attempts: int) -> SlideGraspLiftResult:
        """Try until the object is lifted and held, or cannot be reached any more, or `most_attempts` are spent.

        A slide that stops short is an attempt that spends none, up to `MOST_REGRASPS` times: a push goes on as often.
        """
        done: list[Attempt] = []
        over: Outcome | None = None
        spent = regrasps = 0
        while spent < most_attempts and not over and not (done and done[-1].success):
            if self._stage.begun:
                self._stage.rollout.attempt = len(done) + 1
            done.append(self._attempt(len(done) + 1, done[-1] if done else None))
            short = done[-1].outcome is Outcome.STOPPED_SHORT and regrasps < MOST_REGRASPS
            spent, regrasps = spent + (not short), regrasps + short
            over = self._why_over(done[-1])
        rollout = self._stage.rollout if self._stage.begun else None
        return SlideGraspLiftResult(
            attempts=done,
            trace=rollout.trace if rollout else None,
            ended=None if done[-1].success else over,
            divergence=rollout.divergence if rollout else None,
        )

    def _why_over(self, last: Attempt) -> Outcome | None:
        """Return why there is no further attempt; one that finds nothing to slide with would find nothing again."""
        stuck = last.phase == "slide" and last.configuration < 0
        return self._stage.why_over() or (last.outcome if stuck else None)

    def _attempt(self, number: int, last: Attempt | None) -> Attempt:
        """Slide where the object cannot be grasped, or was not, and may go farther; grasp, lift, hold."""
        if last is not None and last.phase == "approach":
            self._stage.go_out()
        scene = self._stage.scene_now()
        attempt = Attempt(number, "", Outcome.SUCCESS)
        free = overhang(scene)
        must = scene.turn is not None or isinstance(free, tuple)
        if must or (last is not None and last.phase in UNGRASPED and _may_go_on(scene)):
            slid = self._slide(scene, attempt)
            if not slid.success and (must or slid.configuration >= 0):
                return replace(slid, phase="slide")
            attempt = slid if slid.success else attempt
            scene = self._stage.scene_now()
            free = overhang(scene)
        if isinstance(free, tuple):
            return replace(attempt, phase="slide", outcome=free[0], detail=free[1])
        chosen = self._grasp.choose(scene)
        attempt = replace(attempt, overhang=free, grasps=len(self._grasp.found), drawn=self._grasp.drawn)
        if isinstance(chosen, NoGrasp):
            return replace(attempt, **vars(chosen))
        self._grasp.lift(scene, chosen)
        verdict = judge_lift(self._stage.rollout.trace, attempt=number, height=LIFT)
        attempt = replace(attempt, drift=chosen.grasp.drift, **vars(verdict))
        if self._stage.rollout.divergence:
            return replace(attempt, phase=attempt.phase or "hold", outcome=Outcome.DIVERGED)
        if not attempt.success and not self._stage.why_over():
            self._grasp.put_back(chosen)
        return attempt
