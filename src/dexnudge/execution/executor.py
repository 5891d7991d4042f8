"""One configuration in physics: its way to contact, its forces, the push, the verdict."""

import time
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from dexnudge.hands.hand import Hand
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.approach import Approach, ApproachPlanner
from dexnudge.planning.object_path import push_length, supports_of_way
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.drive import push_drive
from dexnudge.simulation.push import PushRun, PushVerdict, judge_push, run_push
from dexnudge.simulation.push_forces import PushForces, push_forces
from dexnudge.simulation.push_model import PushModel, load_push_model
from dexnudge.verification.penetration import PenetrationCheck
from dexnudge.verification.verdicts import contacts_of

EXACT_FRAMES = 8  # of a run at which the hand's depth in its surroundings is also measured by exact distance


@dataclass(frozen=True)
class Execution:
    """What came of one configuration.

    approach: the way to contact; its last, straight stretch is simulated. Without one the hand starts at contact.
    exact_environment: greatest depth of the hand's true links in the surroundings [m] at 8 frames of the run, exact
    distance both ways; the verdict uses the depth of the convex pieces at every step. seconds: by stage.
    """

    verdict: PushVerdict
    run: PushRun
    forces: PushForces
    approach: Approach
    exact_environment: float
    seconds: dict[str, float]


class Executor:
    """Executes configurations of one hand in one scene.

    Args:
        hand, scene: as read from the same files as the model.
        xml: what `push_model_xml(hand, scene)` made.
        length: of the push [m]; the default is `push_length(scene)`.
    """

    def __init__(self, hand: Hand, scene: Scene, xml: str, *, length: float | None = None) -> None:
        self._hand, self._scene = hand, scene
        self._length = push_length(scene) if length is None else length
        self._push = load_push_model(xml, hand, scene)
        self._planner = ApproachPlanner(hand, scene)
        self._exact = PenetrationCheck(hand, scene)
        self._supports, self._task = supports_of_way(scene, self._length), sliding_task(scene)

    def __call__(self, q: Float[np.ndarray, " coordinates"]) -> Execution:
        """The same q gives the same outcome, whatever was executed before."""
        seconds: dict[str, float] = {}
        clock = time.perf_counter()
        approach = self._planner.plan(q)
        seconds["approach"], clock = time.perf_counter() - clock, time.perf_counter()
        (contacts,) = contacts_of(self._scene, self._hand, q[None])
        forces = push_forces(self._push, q, contacts, self._supports, self._task)
        seconds["forces"], clock = time.perf_counter() - clock, time.perf_counter()
        run = self._play(self._push, q, approach, forces)
        seconds["simulation"], clock = time.perf_counter() - clock, time.perf_counter()
        frames = np.unique(np.linspace(0, len(run.time) - 1, EXACT_FRAMES).astype(int))
        configurations = self._push.configurations(run.qpos[frames])
        poses = self._hand.forward_kinematics(torch.as_tensor(configurations)).numpy()
        exact = float(self._exact(poses, reach=0.0).environment.max())
        seconds["exact distance"] = time.perf_counter() - clock
        return Execution(self._judge(run), run, forces, approach, exact, seconds)

    def again(self, q: Float[np.ndarray, " coordinates"], execution: Execution, push: PushModel) -> PushVerdict:
        """The verdict on the same way and forces, played in another model of the same hand and scene.

        Args:
            q: a configuration.
            execution: what came of it here.
            push: for example a model with other frictions, which approach and forces then know nothing of.
        """
        return self._judge(self._play(push, q, execution.approach, execution.forces))

    def _play(
        self, push: PushModel, q: Float[np.ndarray, " coordinates"], approach: Approach, forces: PushForces
    ) -> PushRun:
        times, way = _last_stretch(approach, q)
        drive = push_drive(times, way, motion=self._task.motion, length=self._length)
        return run_push(push, way[0], drive, forces)

    def _judge(self, run: PushRun) -> PushVerdict:
        return judge_push(run, motion=self._task.motion, length=self._length)


def _last_stretch(
    approach: Approach, q: Float[np.ndarray, " coordinates"]
) -> tuple[Float[np.ndarray, " sample"], Float[np.ndarray, "sample coordinates"]]:
    """Times from 0 and configurations from pre-contact to q; q alone where there is no approach."""
    if approach.trajectory is None:
        return np.zeros(1), q[None]
    late = approach.trajectory.times >= approach.pre_contact_time - 1e-9
    return approach.trajectory.times[late] - approach.trajectory.times[late][0], approach.trajectory.q[late]
