"""One configuration in physics: its way to contact, its forces, the push, the verdict."""

import time
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.approach import Approach, ApproachPlanner
from dexnudge.planning.object_path import push_length, supports_of_way
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hand_path import push_path
from dexnudge.simulation.model import SimulationModel
from dexnudge.simulation.push_forces import PushForces, push_forces
from dexnudge.simulation.rollout import Divergence, Rollout, Trace
from dexnudge.simulation.success import PushVerdict, judge_push
from dexnudge.verification.penetration import PenetrationCheck
from dexnudge.verification.verdicts import contacts_of

EXACT_FRAMES = 8  # of a push at which the hand's depth in its surroundings is also measured by exact distance


@dataclass(frozen=True)
class Execution:
    """The push of one configuration.

    Attributes:
        verdict: on the push.
        trace: records of the simulation.
        divergence: None unless the simulation got out of hand.
        forces: with which the hand pressed.
        approach: the way to contact; its last, straight stretch is simulated. Without one the hand starts at contact.
        exact_environment: greatest depth of the hand's true links in the surroundings [m] at 8 frames, by exact distance;
            the verdict uses the depth of the convex pieces at every step.
        seconds: wall time by stage.
    """

    verdict: PushVerdict
    trace: Trace
    divergence: Divergence | None
    forces: PushForces
    approach: Approach
    exact_environment: float
    seconds: dict[str, float]


class Executor:
    """Pushes the object of one scene with configurations of one hand.

    Args:
        scene: the scene.
        simulation: its model, which holds the hand.
        length: of the push [m]; `push_length(scene)` unless given.
    """

    def __init__(self, scene: Scene, simulation: SimulationModel, *, length: float | None = None) -> None:
        self._scene, self._simulation, self._hand = scene, simulation, simulation.hand
        self._length = push_length(scene) if length is None else length
        self._planner = ApproachPlanner(self._hand, scene)
        self._exact = PenetrationCheck(self._hand, scene)
        self._supports, self._task = supports_of_way(scene, self._length), sliding_task(scene)

    def __call__(self, q: Float[np.ndarray, " coordinates"]) -> Execution:
        """Push with q (world); the same q gives the same result, whatever was executed before."""
        seconds: dict[str, float] = {}
        clock = time.perf_counter()
        approach = self._planner.plan(q)
        seconds["approach"], clock = time.perf_counter() - clock, time.perf_counter()
        (contacts,) = contacts_of(self._scene, self._hand, q[None])
        forces = push_forces(self._simulation, q, contacts, self._supports, self._task)
        seconds["forces"], clock = time.perf_counter() - clock, time.perf_counter()
        rollout = self._play(self._simulation, q, approach, forces)
        trace = rollout.trace
        seconds["simulation"], clock = time.perf_counter() - clock, time.perf_counter()
        frames = np.unique(np.linspace(0, len(trace.time) - 1, EXACT_FRAMES).astype(int))
        configurations = self._simulation.configurations(trace.qpos[frames])
        poses = self._hand.forward_kinematics(torch.as_tensor(configurations)).numpy()
        exact = float(self._exact(poses, reach=0.0).environment.max())
        seconds["exact distance"] = time.perf_counter() - clock
        return Execution(self._judge(rollout), trace, rollout.divergence, forces, approach, exact, seconds)

    def again(
        self, q: Float[np.ndarray, " coordinates"], execution: Execution, simulation: SimulationModel
    ) -> PushVerdict:
        """Return the verdict on the same approach and forces, played in another model of the same hand and scene.

        Args:
            q: the configuration.
            execution: its execution here.
            simulation: for example a model with other frictions, of which approach and forces then know nothing.
        """
        return self._judge(self._play(simulation, q, execution.approach, execution.forces))

    def _play(
        self, simulation: SimulationModel, q: Float[np.ndarray, " coordinates"], approach: Approach, forces: PushForces
    ) -> Rollout:
        times, way = (np.zeros(1), q[None]) if approach.blocked else approach.last_stretch
        rollout = Rollout(simulation, way[0])
        rollout.push(push_path(times, way, motion=self._task.motion, length=self._length), forces)
        return rollout

    def _judge(self, rollout: Rollout) -> PushVerdict:
        return judge_push(
            rollout.trace, motion=self._task.motion, length=self._length, diverged=rollout.divergence is not None
        )
