"""How much verdicts on executions depend on what physics leaves open: time step, friction cone, solver.

Approach and forces are planned once; each command holds for 2 ms, however fine the steps are. Contacts keep their
softness, a time constant of 4 ms, so that only the integration differs. Goes on where it was stopped.
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import torch
import tyro

from dexnudge.cli.arguments import stdout, table
from dexnudge.execution.executor import Executor
from dexnudge.jobs.provenance import machine, versions
from dexnudge.results.folder import load_samples
from dexnudge.simulation.model import TIMESTEP, SimulationModel, changed_physics, scene_model

ELLIPTIC, PYRAMIDAL = mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtCone.mjCONE_PYRAMIDAL
NEWTON, CG = mujoco.mjtSolver.mjSOL_NEWTON, mujoco.mjtSolver.mjSOL_CG
SETTINGS = {  # time step, cone, solver; the first is what executions are played with
    "2 ms, elliptic, Newton": (TIMESTEP, ELLIPTIC, NEWTON),
    "1 ms, elliptic, Newton": (TIMESTEP / 2, ELLIPTIC, NEWTON),
    "2 ms, pyramidal, Newton": (TIMESTEP, PYRAMIDAL, NEWTON),
    "2 ms, elliptic, CG": (TIMESTEP, ELLIPTIC, CG),
}
COLUMNS = ("folder", "physics", "outcome", "link_force", "length_asked", "length_reached", "turned_deg")


@dataclass(frozen=True)
class Benchmark:
    """Execute the best verified draw of each folder that `sample` wrote, with every setting."""

    folders: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Folders that `sample` wrote; none: only print the table."""
    out: Path = Path(__file__).parents[1] / "docs/data/physics_sensitivity.csv"
    """Table of all executions."""

    def run(self) -> None:
        """Execute what is missing; print machine, versions, and a line for each setting."""
        torch.set_num_threads(1)
        rows = self.rows()
        for folder in self.folders:
            if any(row["folder"] == folder.name for row in rows):
                continue
            rows += executed(folder)
            with self.out.open("w", newline="") as file:
                writer = csv.DictWriter(file, COLUMNS)
                writer.writeheader()
                writer.writerows(rows)
            print(folder.name, [row["outcome"] for row in rows if row["folder"] == folder.name], flush=True)
        rows = self.rows()
        one = [row for row in rows if row["physics"] == next(iter(SETTINGS))]
        shown = table("physics", "executed [%]", "same verdict [%]", "link force [N]", "off by [N]", "way off by [mm]")
        for name in SETTINGS:
            two = [row for row in rows if row["physics"] == name]
            success = np.array([[row["outcome"] == "success" for row in each] for each in (one, two)])
            force, way = (
                np.array([[float(row[key]) for row in each] for each in (one, two)])
                for key in ("link_force", "length_reached")
            )
            shown.add_row(
                name,
                f"{100 * success[1].mean():.1f}",
                f"{100 * (success[0] == success[1]).mean():.1f}",
                f"{np.median(force[1]):.2f} ({force[1].max():.2f})",
                f"{np.median(np.abs(force[1] - force[0])):.2f} ({np.abs(force[1] - force[0]).max():.2f})",
                f"{1e3 * np.median(np.abs(way[1] - way[0])):.2f} ({1e3 * np.abs(way[1] - way[0]).max():.2f})",
            )
        stdout().print(f"{machine()}\n{versions()}\n{len(one)} executions with each; median (greatest)")
        stdout().print(shown)

    def rows(self) -> list[dict[str, str]]:
        """Return the executions that are done."""
        if not self.out.exists():
            return []
        with self.out.open(newline="") as file:
            return list(csv.DictReader(file))


def executed(folder: Path) -> list[dict[str, str]]:
    """Execute the best verified draw of a folder, if there is one, with every setting."""
    samples = load_samples(folder).verified
    if not len(samples):
        return []
    simulation = scene_model(samples.hand, samples.scene)
    executor = Executor(samples.scene, simulation)
    q = np.asarray(samples[0].q, dtype=np.float64)
    first, rows = executor(q), []
    for index, (name, (timestep, cone, solver)) in enumerate(SETTINGS.items()):
        world = integrated(simulation, timestep, cone, solver)
        verdict = executor.again(q, first, world) if index else first.verdict
        rows.append(
            {
                "folder": folder.name,
                "physics": name,
                "outcome": verdict.outcome.value,
                **{column: f"{getattr(verdict, column):.6g}" for column in COLUMNS[3:]},
            }
        )
    return rows


def integrated(simulation: SimulationModel, timestep: float, cone: int, solver: int) -> SimulationModel:
    """Return a model of its own that is integrated otherwise."""
    changed = changed_physics(simulation)
    changed.model.opt.timestep, changed.model.opt.cone, changed.model.opt.solver = timestep, cone, solver
    return changed


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
