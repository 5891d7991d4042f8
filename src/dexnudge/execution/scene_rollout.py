"""The simulation of one hand in one scene, and what the hand does between pushing, grasping and lifting."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from dexnudge.execution.retreat import retreat
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.approach import Approach
from dexnudge.planning.hand_motion import SpeedLimits
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hand_path import along_line, along_way, bending, waiting
from dexnudge.simulation.model import SimulationModel
from dexnudge.simulation.rollout import Rollout
from dexnudge.simulation.success import MOST_SUNK

FREE_SPEED = 0.10  # [m/s] of a hand that moves away, in the middle of its way
REST_TIME = 0.2  # [s] in which an object that was let go comes to rest


class SceneRollout:
    """A rollout that begins when the hand first goes to the object.

    Attributes:
        hand: the hand.
        first: the scene as it was at the start.
        simulation: its model.
    """

    def __init__(self, first: Scene, simulation: SimulationModel) -> None:
        self.hand, self.first, self.simulation = simulation.hand, first, simulation
        self._rollout: Rollout | None = None

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
        """Return the scene with the object where it is."""
        return replace(self.first, T_world_object=self.rollout.T_world_object) if self.begun else self.first

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
        """Move along the last stretch backward, and on to where the fingers can open."""
        rollout = self.rollout
        times, q = approach.last_stretch
        back = q[::-1].copy()
        back[:, :3] += rollout.commanded[:3] - q[-1, :3]
        rollout.follow(along_way(times, back), "release")
        rollout.follow(waiting(rollout.commanded, seconds=REST_TIME), "release")
        free = None if self.why_over() else retreat(self.hand, self.scene_now(), rollout.q)
        if free is None:
            return
        rollout.follow(along_line(rollout.commanded, free.way, speed=FREE_SPEED), "release")
        for angles in free.openings:
            rollout.follow(bending(rollout.commanded, angles, speed=SpeedLimits().joint), "release")

    def moved(self, since: Scene) -> Float[np.ndarray, " 3"]:
        """Return the way of the object's centre of mass since `since` [m, world]."""
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
