"""Slide, grasp, lift: an object that cannot be grasped where it lies is pushed to where it can, grasped, and lifted.

One continuous simulation. When something fails, the next attempt goes on from where hand and object are then, as a robot
would: with the next configuration where the object still has to slide, else with the next grasp.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dexnudge.execution.grasp_and_lift import LIFT, GraspAndLift, NoGrasp
from dexnudge.execution.grasp_finder import GraspFinder
from dexnudge.execution.scene_rollout import SceneRollout
from dexnudge.execution.slide import Slide, overhang
from dexnudge.planning.outcomes import Outcome
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hold import LiftRehearsal
from dexnudge.simulation.model import SimulationModel
from dexnudge.simulation.rollout import Divergence, Trace
from dexnudge.simulation.success import judge_lift

GRASP_DRAWS = 32  # of grasps at a time, unless told otherwise


@dataclass(frozen=True)
class Attempt:
    """One attempt; None or -1 stands for what it did not come to.

    phase: in which it failed, of "slide", "grasp search", "approach", "lift", "hold"; "" where the object was lifted and
    held. outcome: how it ended. detail: what `outcome` leaves open, for people. configuration: number of the one that slid
    the object; -1 where it lay graspable already. overhang: free share of the object's length after the slide. grasps:
    found, of `drawn` draws so far. drift: of the grasp taken. length_asked, length_reached [m]: of the slide. raised,
    least_held [m], turned_deg, hand_environment [m]: see `LiftVerdict`.
    """

    number: int
    phase: str
    outcome: Outcome
    detail: str = ""
    configuration: int = -1
    overhang: float | None = None
    length_asked: float | None = None
    length_reached: float | None = None
    grasps: int = -1
    drawn: int = -1
    drift: float | None = None
    raised: float | None = None
    least_held: float | None = None
    turned_deg: float | None = None
    hand_environment: float | None = None

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> "Attempt":
        """Make an attempt of what `dataclasses.asdict` and JSON made of it."""
        return cls(**{**content, "outcome": Outcome(content["outcome"])})

    @property
    def success(self) -> bool:
        """Lifted and held."""
        return self.outcome is Outcome.SUCCESS


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
    """Slides, grasps and lifts the object of one scene.

    Args:
        scene: the scene.
        simulation: its model, which holds the hand.
        q: configurations that were sampled for the scene's motion, in the order in which they are to be tried.
        indices: their numbers in the folder.
        sampler: of the same hand, with a prior that knows grasps.
        draws: of grasps at a time.
        seed: of those.
    """

    def __init__(
        self,
        scene: Scene,
        simulation: SimulationModel,
        q: Float[np.ndarray, "n coordinates"],
        indices: Int[np.ndarray, " n"],
        sampler: Sampler,
        *,
        draws: int = GRASP_DRAWS,
        seed: int,
    ) -> None:
        self._stage = SceneRollout(scene, simulation)
        finder = GraspFinder(simulation.hand, sampler, scene, LiftRehearsal(simulation, scene))
        self._slide = Slide(self._stage, dict(zip(indices.tolist(), np.asarray(q, dtype=np.float64), strict=True)))
        self._grasp = GraspAndLift(self._stage, finder, draws=draws, seed=seed)

    def run(self, most_attempts: int) -> SlideGraspLiftResult:
        """Try until the object is lifted and held, or cannot be reached any more, or `most_attempts` are spent."""
        done: list[Attempt] = []
        over: Outcome | None = None
        while len(done) < most_attempts and not over and not (done and done[-1].success):
            if self._stage.begun:
                self._stage.rollout.attempt = len(done) + 1
            done.append(self._attempt(len(done) + 1))
            over = self._stage.why_over()
        rollout = self._stage.rollout if self._stage.begun else None
        return SlideGraspLiftResult(
            attempts=done,
            trace=rollout.trace if rollout else None,
            ended=None if done[-1].success else over,
            divergence=rollout.divergence if rollout else None,
        )

    def _attempt(self, number: int) -> Attempt:
        scene = self._stage.scene_now()
        attempt = Attempt(number, "", Outcome.SUCCESS)
        free, outcome, detail = overhang(scene)
        if free is None:
            slid = self._slide(scene)
            scene = self._stage.scene_now()
            attempt = replace(attempt, **vars(slid))
            outcome, detail = slid.outcome, slid.detail
            if outcome is Outcome.SUCCESS:
                free, outcome, detail = overhang(scene)
        if free is None:
            return replace(attempt, phase="slide", outcome=outcome, detail=detail)
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
