"""How far the distance grid is from the exact distance near the surface, and how long building and reading one take."""

import os
import statistics
import tempfile
import time
from dataclasses import dataclass

import numpy as np
import trimesh
import tyro
from jaxtyping import Float

from dexnudge.cli.arguments import stdout, table
from dexnudge.energies.grid_kernel import PackedGrids, grid_distance, pack_grids
from dexnudge.energies.kernel_inputs import OBJECT_CELL, OBJECT_PADDING
from dexnudge.geometry.distance_grid import DistanceGrid, cached_distance_grid
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.warp_runtime import wp
from dexnudge.jobs.progress import progress
from dexnudge.jobs.provenance import machine, versions
from dexnudge.objects.sets import resolve_object_set

NEAR, ALLOWED = 0.005, 0.25  # [m] from the surface; [mm] at the 99.9th percentile


@wp.kernel(enable_backward=False)
def look_up(grids: PackedGrids, points: wp.array(dtype=wp.vec3), found: wp.array(dtype=float)):
    """Distances as the fused kernel reads them."""
    i = wp.tid()
    found[i] = grid_distance(grids.headers[0], grids.values, points[i])[0]


@dataclass(frozen=True)
class Measured:
    """One object: errors [mm] and exact distances [m] of its points, seconds to build its grid and to read it again."""

    name: str
    error: Float[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]
    built: float
    read: float

    @property
    def percentile(self) -> float:
        """99.9th percentile of the errors [mm]."""
        return _percentile(self.error)


@dataclass(frozen=True)
class Benchmark:
    """Compare grid and exact distance at random points within 5 mm of each object's surface, inside and outside."""

    objects: tuple[str, ...] = ("builtin:test",)
    """Sets of objects: builtin:test, a folder, a text file of paths."""
    num_objects: int | None = None
    """How many of each set, evenly taken from it; all by default."""
    points: int = 20_000
    """Points of each object."""
    seed: int = 0
    """Of the points."""
    show: int = 3
    """How many of the worst objects of each set are named."""

    def run(self) -> None:
        """Print machine, versions and one column for each set."""
        console = stdout()
        console.print("; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items()), soft_wrap=True)
        sets = {}
        with tempfile.TemporaryDirectory() as folder, progress() as bars:
            os.environ["XDG_CACHE_HOME"] = folder  # every grid is built once and read once
            os.environ.pop("DEXNUDGE_CACHE", None)
            self._one("warm-up", trimesh.creation.box((0.02, 0.02, 0.01)))  # compiles the kernels
            for text in self.objects:
                entries = resolve_object_set(text)
                chosen = np.linspace(0, len(entries) - 1, min(self.num_objects or len(entries), len(entries)))
                bar = bars.add_task(text, total=len(chosen))
                sets[text.rsplit("/", 1)[-1]] = found = []
                for index in chosen.round().astype(int):
                    found.append(self._one(entries[index].name, entries[index].load()))
                    bars.advance(bar)
        columns = {name: _summary(found) for name, found in sets.items()}
        shown = table(f"within {1e3 * NEAR:.0f} mm of the surface", *columns)
        for row in next(iter(columns.values())):
            shown.add_row(row, *(column[row] for column in columns.values()))
        console.print(shown)
        for name, found in sets.items():
            worst = sorted(found, key=lambda one: -one.percentile)[: self.show]
            listed = ", ".join(f"{one.name} {one.percentile:.3f}" for one in worst)
            console.print(f"{name}, worst objects, 99.9 % [mm]: {listed}", soft_wrap=True)
        console.print(f"allowed: {ALLOWED} mm at the 99.9th percentile")

    def _one(self, name: str, mesh: trimesh.Trimesh) -> Measured:
        lower, upper = mesh.bounds
        times, grids = [], []
        for _ in range(2):
            start = time.perf_counter()
            grids.append(cached_distance_grid(mesh, lower - OBJECT_PADDING, upper + OBJECT_PADDING, cell=OBJECT_CELL))
            times.append(time.perf_counter() - start)
        points = self._points(mesh)
        distance = ExactDistance(mesh)(points).distance
        near = np.abs(distance) <= NEAR
        error = 1e3 * np.abs(_values(grids[1], points) - distance)
        return Measured(name, error[near], distance[near], *times)

    def _points(self, mesh: trimesh.Trimesh) -> Float[np.ndarray, "n 3"]:
        """Points above and below random places of the surface, single precision as the kernel's."""
        generator = np.random.default_rng(self.seed)
        on_surface, faces = trimesh.sample.sample_surface(mesh, self.points, seed=generator)
        away = generator.uniform(-NEAR, NEAR, self.points)[:, None]
        return (on_surface + away * mesh.face_normals[faces]).astype(np.float32)


def _values(grid: DistanceGrid, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    found = wp.zeros(len(points), dtype=float, device="cpu")
    queried = wp.array(points, dtype=wp.vec3, device="cpu")
    wp.launch(look_up, dim=len(points), inputs=[pack_grids([grid]), queried, found], device="cpu")
    return found.numpy()


def _percentile(error: Float[np.ndarray, " n"]) -> float:
    return float(np.quantile(error, 0.999)) if len(error) else 0.0


def _summary(found: list[Measured]) -> dict[str, str]:
    error, distance = (np.concatenate([getattr(one, key) for one in found]) for key in ("error", "distance"))
    within = sum(one.percentile <= ALLOWED for one in found)
    built, read = [one.built for one in found], [one.read for one in found]
    return {
        "objects": str(len(found)),
        "points": str(len(error)),
        "error, 99.9 %, all points [mm]": f"{_percentile(error):.3f}",
        "  outside": f"{_percentile(error[distance > 0]):.3f}",
        "  inside": f"{_percentile(error[distance <= 0]):.3f}",
        "error, 99.9 %, worst object [mm]": f"{max(one.percentile for one in found):.3f}",
        "error, largest [mm]": f"{error.max():.3f}",
        f"objects within {ALLOWED} mm": f"{within} ({100 * within / len(found):.0f} %)",
        "build, median / most [s]": f"{statistics.median(built):.2f} / {max(built):.2f}",
        "read from the cache, median / most [s]": f"{statistics.median(read):.4f} / {max(read):.4f}",
    }


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
