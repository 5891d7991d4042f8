"""The first act: push the object along the scene's motion until it can be grasped."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.execution.scene_rollout import SceneRollout
from dexnudge.geometry.transforms import transform_configurations
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.approach import Approach, ApproachPlanner
from dexnudge.planning.object_path import GraspableLimits, plan_object_motion, supports_of_way
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hand_path import SPEED, along_line, push_path
from dexnudge.simulation.push_forces import push_forces
from dexnudge.simulation.success import MOST_PENETRATION, MOST_TURNED
from dexnudge.verification.verdicts import contacts_of, verify

AIM = GraspableLimits(overhang=(0.40, 0.45), balance=0.008)  # of the slide, which may fall short or go too far
REACHED = GraspableLimits(overhang=(0.20, 0.90))  # after it: far enough to look for grasps, and not tipping
MOST_CORRECTIONS = 3  # of a push whose object stays behind
CLOSE_BEHIND = 0.003  # [m] that an object may stay behind
MOST_BEHIND, MOST_SHARE_BEHIND = 0.03, 0.3  # [m] + share of the way; an object that is farther behind has been lost
MOST_PLANNED = 6  # configurations that are planned for until one has a way


@dataclass(frozen=True)
class SlideResult:
    """The result of a slide; `configuration` pushed the object, -1 for none.

    detail: what `outcome` leaves open, for people. length_asked, length_reached: of the push, along the motion [m].
    """

    outcome: Outcome
    detail: str = ""
    configuration: int = -1
    length_asked: float | None = None
    length_reached: float | None = None


def overhang(scene: Scene) -> tuple[float | None, Outcome, str]:
    """Return the free share of the object's length if it is graspable where it lies, else why it is not, in detail."""
    plan = plan_object_motion(scene, REACHED)
    if isinstance(plan, Outcome):
        return None, plan, ""
    if plan.length > 0.0:
        detail = f"{1e3 * plan.length:.0f} mm short of {REACHED.overhang[0]:.0%} overhang"
        return None, Outcome.STOPPED_SHORT, detail
    return plan.free.overhang, Outcome.SUCCESS, ""


class Slide:
    """Slides the object of a stage with configurations (number in the folder -> q), each of them once, in their order."""

    def __init__(self, stage: SceneRollout, configurations: dict[int, Float[np.ndarray, " coordinates"]]) -> None:
        self._stage, self._waiting = stage, dict(configurations)

    def __call__(self, scene: Scene) -> SlideResult:
        """Push the object from where it lies in `scene`."""
        plan = plan_object_motion(scene, AIM)
        if isinstance(plan, Outcome):
            plan = plan_object_motion(scene)
        if isinstance(plan, Outcome):
            return SlideResult(plan)
        chosen = self._choose(scene)
        if isinstance(chosen, SlideResult):
            return chosen
        index, q, approach = chosen
        del self._waiting[index]
        rollout = self._stage.go_to_pre_contact(approach, from_outside=False)
        (contacts,) = contacts_of(scene, self._stage.hand, q[None])
        task = sliding_task(scene)
        with rollout.elsewhere():
            supports = supports_of_way(scene, plan.length)
            forces = push_forces(self._stage.model_at(scene), q, contacts, supports, task)
        rollout.push(push_path(*approach.last_stretch, motion=task.motion, length=plan.length), forces)
        self._catch_up(scene, plan.length)
        self._stage.back_off(approach)
        reached = float(self._stage.moved(scene) @ scene.motion)
        return SlideResult(*self._judged(scene), index, plan.length, reached)

    def _choose(self, scene: Scene) -> tuple[int, np.ndarray, Approach] | SlideResult:
        """Return the first configuration that fits the object where it lies now, with its q and a way there."""
        moved = scene.T_world_object @ np.linalg.inv(self._stage.first.T_world_object)
        planner = ApproachPlanner(self._stage.hand, scene)
        failed = SlideResult(Outcome.NO_CONFIGURATION)
        for index, first in list(self._waiting.items())[:MOST_PLANNED]:
            q = np.asarray(transform_configurations(moved, first[None])[0])
            if self._stage.begun:
                verdict = verify(scene, self._stage.hand, q[None])
                if not verdict.success[0]:
                    failed = SlideResult(Outcome.NO_LONGER_FITS, f"configuration {index}: {verdict.reasons[0]}")
                    continue
            approach = planner.plan(q, start=self._stage.q)
            if approach.blocked is None:
                return index, q, approach
            failed = SlideResult(Outcome.APPROACH_BLOCKED, approach.blocked.reason)
        return failed

    def _catch_up(self, scene: Scene, length: float) -> None:
        """Carry on by as much as the object has stayed behind, as a hand that sees the object would."""
        rollout = self._stage.rollout
        for _ in range(MOST_CORRECTIONS):
            behind = length - float(self._stage.moved(scene) @ scene.motion)
            touching = rollout.trace.hand_object_force[-1, 0] > 0
            if not touching or not CLOSE_BEHIND < behind < MOST_BEHIND + MOST_SHARE_BEHIND * length:
                return
            rollout.carry_on(along_line(rollout.commanded, behind * scene.motion, speed=SPEED), "push")

    def _judged(self, before: Scene) -> tuple[Outcome, str]:
        over = self._stage.why_over()
        if over:
            return over, ""
        rollout = self._stage.rollout
        trace = rollout.trace
        depth = trace.hand_environment_depth[trace.attempt == rollout.attempt].max()
        turned = rollout.T_world_object @ np.linalg.inv(before.T_world_object)
        tilt = np.degrees(np.arccos(np.clip(turned[2, 2], -1.0, 1.0)))
        if tilt > MOST_TURNED:
            return Outcome.TIPPED, f"by {tilt:.0f} deg"
        if depth > MOST_PENETRATION:
            return Outcome.HAND_IN_ENVIRONMENT, f"{1e3 * depth:.1f} mm"
        return Outcome.SUCCESS, ""
