"""Slide, grasp, lift: an object that cannot be grasped where it lies is pushed to where it can, grasped, and lifted.

One continuous simulation. When something fails, the next try goes on from where hand and object are then, as a robot
would: with the next configuration of the folder where the object still has to slide, else with the next grasp.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from dexnudge.execution.grasp_and_lift import LIFT, GraspAndLift, NoGrasp
from dexnudge.execution.grasping import GraspFinder
from dexnudge.execution.slide import Slide, overhang, why_not_graspable
from dexnudge.execution.stage import Stage
from dexnudge.hands.hand import Hand
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.episode import Trace
from dexnudge.simulation.lift_verdict import judge_lift
from dexnudge.simulation.push_model import load_push_model
from dexnudge.simulation.rehearsal import lift_rehearsal


@dataclass(frozen=True)
class Try:
    """One try.

    phase: where it failed, of "slide", "grasp search", "approach", "lift", "hold"; "" where the object was lifted and held.
    configuration: of the folder, that slid the object; -1 where it lay graspable already. overhang: free part of the
    object's length after the slide. grasps: found, of `drawn` draws so far. drift: of the grasp taken. raised, least_held
    [m], turned_deg, hand_environment [m]: see `LiftVerdict`. None or -1 where it did not come to that.
    """

    number: int
    phase: str
    reason: str
    configuration: int = -1
    overhang: float | None = None
    grasps: int = -1
    drawn: int = -1
    drift: float | None = None
    raised: float | None = None
    least_held: float | None = None
    turned_deg: float | None = None
    hand_environment: float | None = None

    @property
    def success(self) -> bool:
        """Lifted and held."""
        return not self.phase


@dataclass(frozen=True)
class Story:
    """All tries, at least one, and the trace of the whole simulation; None where nothing could be played.

    ended: why there were no more tries, "" for success or because their number was reached. last_state: MuJoCo's
    integration state at the last record before a divergence, None without one.
    """

    tries: list[Try]
    trace: Trace | None
    ended: str
    last_state: Float[np.ndarray, " state"] | None


GRASP_DRAWS = 32  # of grasps at a time, unless told otherwise


class SlideGraspLift:
    """Runs one story.

    Args:
        hand, scene: as read from the same files as the model.
        xml: what `push_model_xml(hand, scene)` made.
        q: configurations that were sampled for the scene's motion, in the order in which they are to be tried.
        indices: their numbers in the folder.
        sampler: of the same hand, with a prior that knows grasps.
        draws: of grasps at a time. seed: of those.
    """

    def __init__(
        self,
        hand: Hand,
        scene: Scene,
        xml: str,
        q: Float[np.ndarray, "n coordinates"],
        indices: Int[np.ndarray, " n"],
        sampler: Sampler,
        *,
        draws: int,
        seed: int,
    ) -> None:
        self._stage = Stage(hand, scene, load_push_model(xml, hand, scene))
        finder = GraspFinder(hand, sampler, scene, lift_rehearsal(xml, hand, scene))
        self._slide = Slide(self._stage, dict(zip(indices.tolist(), np.asarray(q, dtype=np.float64), strict=True)))
        self._grasp = GraspAndLift(self._stage, finder, draws=draws, seed=seed)

    def run(self, tries: int) -> Story:
        """Try until the object is lifted and held, or cannot be reached any more, or `tries` are spent."""
        done: list[Try] = []
        over = ""
        while len(done) < tries and not over and not (done and done[-1].success):
            if self._stage.episode is not None:
                self._stage.episode.attempt = len(done) + 1
            done.append(self._try(len(done) + 1))
            over = self._stage.why_over()
        episode = self._stage.episode
        return Story(
            tries=done,
            trace=None if episode is None else episode.trace,
            ended="" if done[-1].success else over,
            last_state=episode.last_state if episode is not None and episode.diverged else None,
        )

    def _try(self, number: int) -> Try:
        scene, index = self._stage.scene_now(), -1
        free = overhang(scene)
        if free is None:
            index, reason = self._slide(scene)
            scene = self._stage.scene_now()
            free = None if reason else overhang(scene)
            if free is None:
                return Try(number, "slide", reason or why_not_graspable(scene), index)
        chosen = self._grasp.choose(scene)
        found = Try(number, "", "", index, free, len(self._grasp.found), self._grasp.drawn)
        if isinstance(chosen, NoGrasp):
            return replace(found, phase=chosen.phase, reason=chosen.reason)
        self._grasp.lift(scene, chosen)
        assert self._stage.episode is not None
        verdict = judge_lift(self._stage.episode.trace, attempt=number, height=LIFT)
        found = replace(found, drift=chosen.grasp.drift, **vars(verdict))
        if self._stage.episode.diverged:
            return replace(found, phase=found.phase or "hold", reason="the simulation diverged")
        if not found.success and not self._stage.why_over():
            self._grasp.put_back(chosen)
        return found
