"""Where a story plays: one hand, one scene, one simulation, and what happens between its acts."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from dexnudge.execution.retreat import retreat
from dexnudge.hands.hand import Hand
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.approach import Approach
from dexnudge.planning.trajectory import SpeedLimits
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.episode import Episode
from dexnudge.simulation.hand_path import along_line, along_way, bending, waiting
from dexnudge.simulation.push import MOST_SUNK
from dexnudge.simulation.push_model import PushModel

FREE_SPEED = 0.10  # [m/s] of a hand that moves away, in the middle of its way
REST_TIME = 0.2  # [s] in which an object that was let go comes to rest


@dataclass(frozen=True)
class Stretches:
    """An approach in two: `before` up to pre-contact, (times [s], q); then `times` from 0 and `q` to contact."""

    before: tuple[Float[np.ndarray, " sample"], Float[np.ndarray, "sample coordinates"]]
    times: Float[np.ndarray, " late"]
    q: Float[np.ndarray, "late coordinates"]


def stretches(approach: Approach) -> Stretches:
    """The two stretches of an approach that has a trajectory."""
    assert approach.trajectory is not None
    times, q = approach.trajectory.times, approach.trajectory.q
    late = times >= approach.pre_contact_time - 1e-9
    early = times <= times[late][0]
    return Stretches((times[early], q[early]), times[late] - times[late][0], q[late])


class Stage:
    """A story's simulation, which begins with the first act.

    Attributes:
        hand, first: the hand, and the scene as it was at the start.
        model: of that scene.
        episode: the simulation; None before the first act.
    """

    def __init__(self, hand: Hand, first: Scene, model: PushModel) -> None:
        self.hand, self.first, self.model = hand, first, model
        self.episode: Episode | None = None

    @property
    def q(self) -> Float[np.ndarray, " coordinates"] | None:
        """Where the hand is; None where it may still come from anywhere."""
        return None if self.episode is None else self.episode.q

    def scene_now(self) -> Scene:
        """The scene with the object where it is."""
        if self.episode is None:
            return self.first
        return replace(self.first, T_world_object=self.episode.T_world_object)

    def model_at(self, scene: Scene) -> PushModel:
        """The model, which places the object where `scene` has it."""
        return replace(self.model, T_world_object=scene.T_world_object)

    def go_to(self, approach: Approach, *, all_the_way: bool) -> Episode:
        """The hand moves to pre-contact; a simulation that begins here begins at pre-contact, or else outside."""
        way = stretches(approach)
        if self.episode is None:
            self.episode = Episode(self.model, way.before[1][0] if all_the_way else way.q[0])
            if not all_the_way:
                return self.episode
        self.episode.play(along_way(*way.before), "transit")
        return self.episode

    def back_off(self, approach: Approach) -> None:
        """The last stretch backward from where the hand is told to be, and on to where the fingers can open."""
        assert self.episode is not None
        way, episode = stretches(approach), self.episode
        back = way.q[::-1].copy()
        back[:, :3] += episode.told[:3] - way.q[-1, :3]
        episode.play(along_way(way.times, back), "release")
        episode.play(waiting(episode.told, seconds=REST_TIME), "release")
        free = None if self.why_over() else retreat(self.hand, self.scene_now(), episode.q)
        if free is None:
            return
        episode.play(along_line(episode.told, free.way, speed=FREE_SPEED), "release")
        for angles in free.openings:
            episode.play(bending(episode.told, angles, speed=SpeedLimits().joint), "release")

    def sunk(self) -> float:
        """How far the object's centre of mass is below where it lay first [m]; a motion downhill is no sinking."""
        moved = sliding_task(self.scene_now()).centre - sliding_task(self.first).centre
        motion = self.first.motion
        return float(motion[2] * (moved @ motion) - moved[2])

    def why_over(self) -> str:
        """Why nothing further can be tried; "" if it can."""
        if self.episode is None:
            return "nothing could be played"
        if self.episode.diverged:
            return "the simulation diverged"
        return "the object fell" if self.sunk() > MOST_SUNK else ""
