"""The first act: the object is pushed along the scene's motion until it can be grasped."""

import numpy as np
from jaxtyping import Float

from dexnudge.execution.stage import Stage, stretches
from dexnudge.geometry.transforms import transform_configurations
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.approach import Approach, ApproachPlanner
from dexnudge.planning.object_path import (
    DEFAULT_LIMITS,
    GraspableLimits,
    NoObjectMotion,
    ObjectMotion,
    plan_object_motion,
    supports_of_way,
)
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.drive import SPEED, push_drive
from dexnudge.simulation.hand_path import along_line
from dexnudge.simulation.push import MOST_PENETRATION, MOST_TURNED
from dexnudge.simulation.push_forces import push_forces
from dexnudge.verification.verdicts import contacts_of, verify

AIM = GraspableLimits(overhang=(0.40, 0.45), balance=0.008)  # of the slide, which may fall short or go too far
REACHED = GraspableLimits(overhang=(0.20, 0.90))  # after it: far enough to look for grasps, and not tipping
MOST_CORRECTIONS = 3  # of a push whose object stays behind
CLOSE_BEHIND = 0.003  # [m] that an object may stay behind
MOST_BEHIND, MOST_SHARE_BEHIND = 0.03, 0.3  # [m] + share of the way; an object that is farther behind has been lost
MOST_PLANNED = 6  # configurations that are planned for until one has a way


def overhang(scene: Scene) -> float | None:
    """Free part of the object's length if it is graspable where it lies; see `GraspableLimits`."""
    plan = plan_object_motion(scene, REACHED, own_motion_only=True)
    return plan.overhang if isinstance(plan, ObjectMotion) and plan.length == 0.0 else None


def why_not_graspable(scene: Scene) -> str:
    """What is missing where `overhang` is None."""
    plan = plan_object_motion(scene, REACHED, own_motion_only=True)
    if isinstance(plan, NoObjectMotion):
        return plan.reason
    return f"stopped {1e3 * plan.length:.0f} mm short of {REACHED.overhang[0]:.0%} overhang"


class Slide:
    """Slides the object of a stage with configurations (number in the folder -> q), each of them once, in their order."""

    def __init__(self, stage: Stage, configurations: dict[int, Float[np.ndarray, " coordinates"]]) -> None:
        self._stage, self._waiting = stage, dict(configurations)

    def __call__(self, scene: Scene) -> tuple[int, str]:
        """Push the object; the configuration that did, -1 for none, and what went wrong, "" for nothing."""
        plan = plan_object_motion(scene, AIM, own_motion_only=True)
        if isinstance(plan, NoObjectMotion):
            plan = plan_object_motion(scene, DEFAULT_LIMITS, own_motion_only=True)
        if isinstance(plan, NoObjectMotion):
            return -1, plan.reason
        index, q, approach, reason = self._choose(scene)
        if approach is None:
            return -1, reason
        del self._waiting[index]
        episode = self._stage.go_to(approach, all_the_way=False)
        (contacts,) = contacts_of(scene, self._stage.hand, q[None])
        task, way = sliding_task(scene), stretches(approach)
        with episode.elsewhere():
            supports = supports_of_way(scene, plan.length)
            forces = push_forces(self._stage.model_at(scene), q, contacts, supports, task)
        episode.slide(push_drive(way.times, way.q, motion=task.motion, length=plan.length), forces)
        self._catch_up(scene, plan.length)
        self._stage.back_off(approach)
        return index, self._what_went_wrong(scene)

    def _choose(self, scene: Scene) -> tuple[int, np.ndarray, Approach | None, str]:
        """The first configuration that fits the object where it lies now and has a way there."""
        moved = scene.T_world_object @ np.linalg.inv(self._stage.first.T_world_object)
        planner = ApproachPlanner(self._stage.hand, scene)
        reason = "no configuration of the folder is left"
        for index, first in list(self._waiting.items())[:MOST_PLANNED]:
            q = np.asarray(transform_configurations(moved, first[None])[0])
            if self._stage.episode is not None:
                verdict = verify(scene, self._stage.hand, q[None])
                if not verdict.success[0]:
                    reason = f"configuration {index} no longer fits: {verdict.reasons[0]}"
                    continue
            approach = planner.plan(q, start=self._stage.q)
            if approach.blocked is None:
                return index, q, approach, ""
            reason = f"approach blocked: {approach.blocked.reason}"
        return -1, np.zeros(0), None, reason

    def _catch_up(self, scene: Scene, length: float) -> None:
        """The hand goes on by as much as the object has stayed behind, as one that sees the object would."""
        assert self._stage.episode is not None
        for _ in range(MOST_CORRECTIONS):
            moved = sliding_task(self._stage.scene_now()).centre - sliding_task(scene).centre
            behind = length - float(moved @ scene.motion)
            touching = self._stage.episode.trace.hand_object_force[-1, 0] > 0
            if not touching or not CLOSE_BEHIND < behind < MOST_BEHIND + MOST_SHARE_BEHIND * length:
                return
            way = along_line(self._stage.episode.told, behind * scene.motion, speed=SPEED)
            self._stage.episode.carry_on(way, "push")

    def _what_went_wrong(self, before: Scene) -> str:
        assert self._stage.episode is not None
        over = self._stage.why_over()
        if over:
            return over
        trace = self._stage.episode.trace
        depth = trace.hand_environment_depth[trace.attempt == self._stage.episode.attempt].max()
        turned = self._stage.episode.T_world_object @ np.linalg.inv(before.T_world_object)
        tilt = np.degrees(np.arccos(np.clip(turned[2, 2], -1.0, 1.0)))
        if tilt > MOST_TURNED:
            return f"the object tipped by {tilt:.0f} deg"
        if depth > MOST_PENETRATION:
            return f"hand {1e3 * depth:.1f} mm into the environment"
        return ""
