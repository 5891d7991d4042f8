"""Where the time of an execution goes, stage by stage on one core, and how much of the simulation is MuJoCo's own steps."""

import time
from dataclasses import dataclass

import mujoco
import numpy as np
import torch
import tyro

from dexnudge.cli.arguments import stdout, table
from dexnudge.execution.executor import Executor
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.provenance import machine, versions
from dexnudge.objects.sets import resolve_object_set
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.simulation.model import TIMESTEP, SimulationModel, scene_model
from dexnudge.simulation.rollout import Trace


@dataclass(frozen=True)
class Benchmark:
    """Execute verified draws for one object in some scenes, after one that is not counted."""

    objects: str = "builtin:test"
    """Set of objects, of which the first is taken."""
    scenes: tuple[str, ...] = ("table", "layers", "shelf")
    """Scene families."""
    num: int = 8
    """Verified draws that are executed in each scene."""
    hand: str = "shadow_lite"
    """Hand."""
    seed: int = 0
    """Seed of scenes and draws."""

    def run(self) -> None:
        """Print machine, versions, and a line for each scene."""
        torch.set_num_threads(1)
        console = stdout()
        console.print("; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items()), soft_wrap=True)
        shown = table(
            "scene",
            "executed",
            "approach s",
            "forces s",
            "simulation s",
            "x real time",
            "x bare steps",
        )
        for scene in self.scenes:
            shown.add_row(scene, *self._line(scene))
        console.print(shown)
        console.print(
            "seconds: median of the executions; bare steps: MuJoCo's alone, with the hand told the same every 20 ms"
        )

    def _line(self, family: str) -> list[str]:
        hand = load_hand(self.hand)
        scene = build_scene(family, resolve_object_set(self.objects)[0].load(), seed=self.seed)
        draws = Sampler(hand).sample(scene, seed=self.seed, verified=self.num + 1)
        chosen = np.asarray(draws.q, dtype=float)[: min(self.num + 1, draws.num_verified)]
        simulation = scene_model(hand, scene)
        executor = Executor(scene, simulation)
        done = [executor(q) for q in chosen][1:]
        seconds = {stage: np.median([one.seconds[stage] for one in done]) for stage in done[0].seconds}
        simulated = wall = bare = 0.0
        for one in done:
            wall += one.seconds["simulation"]
            simulated += float(one.trace.time[-1])
            bare += _bare_steps(simulation, one.trace)
        cells = [f"{seconds[stage]:.3f}" for stage in ("approach", "forces", "simulation")]
        return [str(len(done)), *cells, f"{simulated / wall:.1f}", f"{wall / bare:.2f}"]


def _bare_steps(simulation: SimulationModel, trace: Trace) -> float:
    """Seconds of MuJoCo's steps alone, told at each record of the trace what its hand was told then."""
    model, data = simulation.model, simulation.data
    mujoco.mj_resetData(model, data)
    data.qpos[:] = trace.qpos[0]
    steps = np.diff(np.round(trace.time / TIMESTEP).astype(int))
    start = time.perf_counter()
    for count, ctrl, mocap in zip(steps, trace.ctrl[1:], trace.mocap[1:], strict=True):
        data.ctrl[:], data.mocap_pos[0], data.mocap_quat[0] = ctrl, mocap[:3], mocap[3:]
        mujoco.mj_step(model, data, count)
    return time.perf_counter() - start


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
