"""An arm's way for a push: from home to contact, along the push, and back home."""

import time
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from dexnudge.arms.robot import Robot
from dexnudge.planning.arm_approach import ArmApproach, Entry, NoWay
from dexnudge.planning.hand_clearance import HandClearance
from dexnudge.scenes.scene import Scene

SPACING = 0.004  # [m] between stations of the push
SHIFTS = 41  # places of the hand that are looked at on the push
DEEPEST = 0.0008  # [m] of the hand in its surroundings on the push: below what a configuration may have
MOST_ENTRIES = 4  # that the planner may choose from


@dataclass(frozen=True)
class PushWay:
    """Positions of arm and hand; each part begins where the one before ends.

    transit: vertices of straight motions in joint space, from home into the open. entry: into contact, to be read backward.
    push: stations from contact on. leave: out of contact after it. home: vertices of straight motions.
    """

    transit: Float[np.ndarray, "coming joint"]
    entry: Entry
    push: Float[np.ndarray, "station joint"]
    leave: Entry
    home: Float[np.ndarray, "going joint"]


class PushWayPlanner:
    """Plans pushes by `length` [m] for one robot in one scene; make it once for many configurations.

    Attributes:
        moved: the scene after the push.
        seconds: wall time by stage, of all configurations so far.
    """

    def __init__(self, robot: Robot, scene: Scene, *, length: float, seed: int = 0) -> None:
        self.seconds: dict[str, float] = {}
        self._clock = time.perf_counter()
        T_world_object = np.array(scene.T_world_object)
        T_world_object[:3, 3] += length * scene.motion
        self.robot, self.scene, self.length = robot, scene, length
        self.moved = replace(scene, T_world_object=T_world_object)
        self.before = ArmApproach(robot, scene, seed=seed)
        self.after = ArmApproach(robot, self.moved, contact="retreat", before="retreat", seed=seed)
        self._hand = HandClearance(robot.hand, scene)
        self._lap("set-up")

    def plan(self, q: Float[np.ndarray, " coordinates"]) -> PushWay | NoWay:
        """Return the way for the configuration q (world), or the first phase that has none."""
        self._clock = time.perf_counter()
        q, home = np.asarray(q, dtype=np.float64), self.robot.arm.home
        way = self._carried(q)
        shifts = np.linspace(0.0, self.length, SHIFTS)[:, None] * self.scene.motion
        sunk = -float(self._hand.shifted(q, shifts).distance[:, 0].min())
        if sunk > DEEPEST:
            return NoWay("push", f"the hand gets {1e3 * sunk:.1f} mm into the surroundings")
        entering = self.before.hand_ways(q)
        if isinstance(entering, NoWay):
            return entering
        leaving = self.after.hand_ways(way[-1])
        self._lap("hand")
        if isinstance(leaving, NoWay):
            return leaving
        pushes = self._pushes(way)
        self._lap("push")
        if isinstance(pushes, NoWay):
            return pushes
        failed, entries, pushed = NoWay("contact", ""), [], []
        for push in pushes:
            found = self.before.entries(entering, push[0])
            if isinstance(found, NoWay):
                failed = found
                continue
            left = self.after.entries(leaving, push[-1])
            if isinstance(left, NoWay):
                failed = left
                continue
            entries += found
            pushed += [(push, left)] * len(found)
            if len(entries) >= MOST_ENTRIES:
                break
        self._lap("entry")
        if not entries:
            return failed
        coming = self.before.transit(entering.waiting, home, entries)
        self._lap("transit")
        if isinstance(coming, NoWay):
            return coming
        push, leaves = pushed[coming[1]]
        going = self.after.transit(leaving.waiting, home, leaves)
        self._lap("home")
        if isinstance(going, NoWay):
            return going
        return PushWay(coming[0], entries[coming[1]], push, leaves[going[1]], going[0][::-1])

    def _carried(self, q: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, "station coordinates"]:
        """Return q at stations along the push."""
        count = int(np.ceil(self.length / SPACING)) + 1
        way = np.repeat(q[None], count, axis=0)
        way[:, :3] += np.linspace(0.0, self.length, count)[:, None] * self.scene.motion
        return way

    def _pushes(
        self, way: Float[np.ndarray, "station coordinates"]
    ) -> list[Float[np.ndarray, "station joint"]] | NoWay:
        """Return positions along the push of every solution of the arm that goes to its end, farthest from limits first."""
        solved = self.before.solutions(way[0])
        if not len(solved):
            return NoWay("contact", "out of reach")
        positions, reached = self.before.followed(np.repeat(way[None], len(solved), axis=0), solved)
        if reached.max() < len(way):
            done = self.length * max(0, reached.max() - 1) / (len(way) - 1)
            return NoWay("push", f"out of reach after {1e3 * done:.0f} of {1e3 * self.length:.0f} mm")
        failed, free = NoWay("push", ""), []
        for push in positions[reached == len(way)]:
            blocked = self.before.what_blocks(push)
            if blocked:
                failed = NoWay("push", blocked)
            else:
                free.append(push)
        arm = self.robot.arm
        return sorted(free, key=lambda push: arm.limits.room(push[:, : arm.num_joints]).min(), reverse=True) or failed

    def _lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._clock
        self._clock = now
