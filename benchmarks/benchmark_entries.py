"""Fills three entries of a benchmark suite, has them judged, and writes the table into docs/benchmark.md.

- dexnudge: `Sampler`, as it ships.
- random-start: random hands around the object, projected out of everything: what geometry alone gives, without a model.
- grasps: force-closure grasps of the object in free space, by the optimiser that makes the grasps of the dataset; placed
  with the object, those that are least deep in the surroundings first. A grasp generator that is told of the scene only
  what a collision check tells.
"""

import json
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

import dexnudge as dn
from dexnudge.benchmark.entry import ANSWERS, ENTRY
from dexnudge.benchmark.score import score
from dexnudge.benchmark.suite import load_suite
from dexnudge.benchmark.tasks import MANIFEST, TaskSet, load_tasks, make_tasks
from dexnudge.energies.kernel_inputs import build_scene_fields
from dexnudge.formats.hand_poses import palm_poses
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.geometry.surface_points import surface_points
from dexnudge.geometry.transforms import transform_configurations
from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.jobs.provenance import machine
from dexnudge.sampling.methods import find_method
from dexnudge.sampling.problem import prepare
from dexnudge.synthesis.grasps import GraspConfig, descend_to_grasp

PAGE = Path(__file__).parents[1] / "docs" / "benchmark.md"
COPIES = {"report.csv": "data/benchmark/small.csv", "rates.png": "images/benchmark.png"}  # beside the page
BEGIN, END = "<!-- table:begin -->", "<!-- table:end -->"
SPACING = 0.002  # [m] of the points that grasps aim at
GRASPS = 64  # of which a task's are chosen
SEED = 0
Draw = Callable[[dn.Scene, dn.Hand, int], np.ndarray]


def by_sampler(method: str) -> Draw:
    """Return what draws with the sampler, in the sampler's own order: nothing is verified."""
    samplers: dict[str, dn.Sampler] = {}

    def draw(scene: dn.Scene, hand: dn.Hand, num: int) -> np.ndarray:
        sampler = samplers.setdefault(hand.name, dn.Sampler(hand))
        return sampler.draw(prepare(scene), num=num, seed=SEED, method=find_method(method)).q

    return draw


def grasps(scene: dn.Scene, hand: dn.Hand, num: int) -> np.ndarray:
    """Grasps of the object in free space, those least deep in anything in the scene first."""
    mesh, generator = scene.object_mesh, np.random.default_rng(SEED)
    surface, fields = surface_points(mesh, spacing=SPACING), build_scene_fields(mesh, None)
    config = GraspConfig(batch=GRASPS)
    found = descend_to_grasp(hand, fields, surface, centre_of_mass(mesh), config=config, generator=generator)
    q = transform_configurations(scene.T_world_object, found.numpy().astype(np.float64))
    return q[np.argsort(dn.verify(scene, hand, q).deepest_penetration)[:num]]


METHODS: dict[str, tuple[Draw, str]] = {
    "dexnudge": (by_sampler("steered_noise"), "meshes of object and surroundings; weights learned from builtin:train"),
    "random-start": (by_sampler("random_start_projection"), "meshes of object and surroundings; no weights"),
    "grasps": (grasps, "the object's mesh, no weights; a collision check with the surroundings ranks"),
}


def fill(name: str, tasks: TaskSet, folder: Path) -> None:
    """Write the entry of a method; answers that are there stay."""
    draw, used = METHODS[name]
    (folder / ANSWERS).mkdir(parents=True, exist_ok=True)
    seconds_file = folder / "seconds.json"
    seconds = json.loads(seconds_file.read_text()) if seconds_file.exists() else {}
    for task in tasks.tasks:
        path = folder / ANSWERS / f"{task.name}.json"
        if path.exists():
            continue
        begin = time.process_time()
        q = draw(tasks.scene(task), tasks.hand, tasks.suite.draws)
        seconds[task.name] = round(time.process_time() - begin, 2)
        answer = {
            "joint_names": list(tasks.hand.joint_names),
            "T_world_palm": palm_poses(q).tolist(),
            "joint_angles": q[:, ROOT_COORDINATES:].tolist(),
        }
        path.write_text(json.dumps(answer))
        seconds_file.write_text(json.dumps(seconds))
    where = machine()
    entry = {"name": name, "authors": "The dexnudge authors", "used": used, "seconds": seconds}
    entry["machine"] = f"{where['processor']}, one core, seconds of processor time"
    (folder / ENTRY).write_text(json.dumps(entry, indent=2))


@dataclass(frozen=True)
class Entries:
    """Make tasks, fill the entries, judge them, and write the page's table."""

    suite: Annotated[str, tyro.conf.Positional] = "small"
    """Built-in suite or YAML file."""
    methods: tuple[str, ...] = tuple(METHODS)
    """Entries."""
    out: Path = Path("runs/benchmark")
    """Folder of tasks, entries and scores; one that was stopped goes on."""
    workers: int = 2
    """Processes of the judge."""
    page: Path | None = PAGE
    """Page whose table is written anew."""

    def run(self) -> None:
        """Make, fill, judge, write."""
        place = self.out / "tasks"
        tasks = load_tasks(place) if (place / MANIFEST).exists() else make_tasks(load_suite(self.suite), place)
        for name in self.methods:
            fill(name, tasks, self.out / "entries" / name)
        folders = [self.out / "entries" / name for name in self.methods]
        text = score(folders, place, self.out / "scores", workers=self.workers)
        print(text)
        if self.page is not None:
            before, _, rest = self.page.read_text(encoding="utf-8").partition(BEGIN)
            table = text.partition("\n\n")[2].partition("\n\n## ")[0]
            self.page.write_text(f"{before}{BEGIN}\n{table}\n{END}{rest.partition(END)[2]}", encoding="utf-8")
            for file, place in COPIES.items():
                (self.page.parent / place).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(self.out / "scores" / file, self.page.parent / place)


if __name__ == "__main__":
    tyro.cli(Entries).run()
