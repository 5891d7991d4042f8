"""One row of executions: the draws of an experiment's row, made again, and the best of them played out in physics."""

import time

import numpy as np
from jaxtyping import Float

from dexnudge.errors import DexnudgeError
from dexnudge.execution.executor import Executor
from dexnudge.experiments.config import ExperimentConfig, Task, row_seed
from dexnudge.experiments.experiment_rows import Executed, ExecutionRow
from dexnudge.experiments.row_maker import RowMaker
from dexnudge.experiments.sweeps import setting_name
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.results.samples import Samples
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.model import SimulationModel, changed_physics, scene_model
from dexnudge.synthesis.acceptance import PRESSING

ERRORS: dict[str, tuple[float, ...]] = {
    "friction_hand": (0.5, 1.5),
    "friction_environment": (0.5, 1.5),
    "mass": (0.5, 1.5),
}
"""Quantity of the scene -> factors on it in the physics, while approach and forces are planned without them."""


class ExecutionRowMaker:
    """Computes rows one after another, with the hand and the weights loaded once.

    Args:
        config: of the experiment.
        num: verified draws to execute, best first.
        errors: whether the best one is also played in the changed physics of `ERRORS`.
    """

    def __init__(self, config: ExperimentConfig, num: int, *, errors: bool) -> None:
        self._config, self._num, self._errors = config, num, errors
        self._rows = RowMaker(config)

    def __call__(self, task: Task) -> ExecutionRow:
        """The row of a task. What cannot be read, placed or simulated gives a failed row."""
        try:
            clock = time.perf_counter()
            drawn = self._rows.draw(task)
            drawing = time.perf_counter() - clock
            executed = self._execute(drawn.scene, drawn.draws)
        except DexnudgeError as error:
            return failed_execution(self._config, task, f"{type(error).__name__}: {error}")
        seconds = {"draw": round(drawing, 4), "execute": round(time.perf_counter() - clock - drawing, 4)}
        return ExecutionRow(
            object=task.object,
            scene=task.scene,
            method=task.method,
            status="executed",
            seed=row_seed(self._config.seed, task),
            drawn=len(drawn.draws.q),
            verified=drawn.draws.num_verified,
            configurations=executed,
            seconds=seconds,
        )

    def _execute(self, scene: Scene, draws: Samples) -> list[Executed]:
        chosen = np.flatnonzero(draws.verdicts.success)[: self._num].tolist()
        if not chosen:
            return []
        hand = self._rows.hand
        simulation = scene_model(hand, scene)
        executor = Executor(scene, simulation)
        return [self._executed(rank, executor, draws, index, scene, simulation) for rank, index in enumerate(chosen)]

    def _executed(
        self, rank: int, executor: Executor, draws: Samples, index: int, scene: Scene, simulation: SimulationModel
    ) -> Executed:
        q = draws.q[index].astype(np.float64)
        found = executor(q)
        verdict = found.verdict
        changed = {}
        if self._errors and rank == 0:
            changed = {
                setting_name(quantity, factor): executor.again(
                    q, found, changed_physics(simulation, **{quantity: factor})
                ).success
                for quantity, factors in ERRORS.items()
                for factor in factors
            }
        return Executed(
            rank=rank,
            force_margin=round(float(draws.verdicts.force_margin[index]), 4),
            links=len(draws.verdicts.contact_links[index]),
            behaviour=behaviour_in_scene(
                draws.verdicts.contacts[index], scene.motion, q[:3] - scene.object_in_world().center_mass
            ),
            success=verdict.success,
            reason="" if verdict.success else verdict.outcome.value.replace("_", " "),
            advanced=round(verdict.length_reached, 5),
            turned_deg=round(verdict.turned_deg, 3),
            sunk=round(verdict.sunk, 5),
            hand_environment=round(verdict.hand_environment, 6),
            cone_share=float(found.forces.cone_share[0]),
            approach="" if found.approach.trajectory is None else found.approach.planner,
            changed=changed,
        )


def behaviour_in_scene(contacts: HandContacts, motion: Float[np.ndarray, "3"], root: Float[np.ndarray, "3"]) -> str:
    """press, hook or push, by the rule of the dataset (`synthesis.acceptance.behaviour_of`) for the scene's motion.

    press: the contacts' mean outward normal points up. Otherwise hook if the hand's root lies ahead of the object (it
    pulls), else push. root: from the object's middle [m, world].
    """
    if contacts.normals[:, 2].mean() > PRESSING:
        return "press"
    return "hook" if float(root @ motion) > 0 else "push"


def failed_execution(config: ExperimentConfig, task: Task, reason: str) -> ExecutionRow:
    """A row that counts as one object whose best draw did not succeed."""
    return ExecutionRow(
        object=task.object,
        scene=task.scene,
        method=task.method,
        status="failed",
        reason=reason,
        seed=row_seed(config.seed, task),
    )
