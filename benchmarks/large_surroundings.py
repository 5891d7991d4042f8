"""Seconds and memory by triangles of the surroundings: a scanned table with clutter in a room, from the file to verdicts."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import tyro

from dexnudge.cli.arguments import stdout, table
from dexnudge.geometry.meshes import load_environment
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.provenance import machine, peak_memory_mb, versions
from dexnudge.objects.builtin import builtin_object
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.resting import place_at_rest
from dexnudge.scenes.scene import Scene

ROOT = Path(__file__).parents[1]
DATA, PAGE = ROOT / "docs/data/large_surroundings.json", ROOT / "docs/concepts/performance.md"
BEGIN, END = "<!-- surroundings:begin -->", "<!-- surroundings:end -->"
COLUMNS = {  # key: (header, digits)
    "triangles": ("triangles", 0),
    "file_mb": ("file [MB]", 0),
    "kept": ("near, and coarse far ones", 0),
    "load": ("read [s]", 1),
    "scene": ("understand [s]", 1),
    "prepare": ("prepare [s]", 1),
    "verify": ("verify 32 [s]", 1),
    "rank": ("rank [s]", 1),
    "save": ("write [s]", 1),
    "base_mb": ("memory before [MB]", 0),
    "peak_mb": ("peak [MB]", 0),
    "verified": ("verified of 32", 0),
}
ON_TABLE = 0.4  # of the triangles; the others are floor and walls
TABLE, FLOOR, ROOM = (1.2, 0.8), -0.75, 4.0  # [m] table top, height of the floor below it, side of the room
NOISE = 2e-4  # [m] root mean square of the scan, evenly spread
CLUTTER = ((0.25, 0.15, 0.10, 0.06, 0.09), (-0.30, 0.20, 0.08, 0.12, 0.05), (-0.25, -0.25, 0.15, 0.05, 0.03))


def scanned_room(triangles: int, *, seed: int = 0) -> trimesh.Trimesh:
    """Return an open, noisy scan of a room with a table, top at z = 0, clutter on it; free around the origin.

    Boxes of clutter: centre x, y, sides x, y, height [m].
    """
    generator = np.random.default_rng(seed)
    counts = [int(ON_TABLE * triangles), *[int((1 - ON_TABLE) * triangles / 3)] * 3]
    half = ROOM / 2
    top = _sheet(TABLE, counts[0])
    for x, y, wide, deep, high in CLUTTER:
        inside = (np.abs(top.vertices[:, :2] - [x, y]) < [wide / 2, deep / 2]).all(axis=1)
        top.vertices[inside, 2] = high
    floor, left, back = (_sheet((ROOM, ROOM), count) for count in counts[1:])
    floor.apply_translation((0, 0, FLOOR))
    left.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0], [0, 0, 0]))
    left.apply_translation((-half, 0, FLOOR + half))
    back.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0], [0, 0, 0]))
    back.apply_translation((0, half, FLOOR + half))
    room = trimesh.util.concatenate([top, floor, left, back])
    room.vertices += generator.uniform(-1, 1, room.vertices.shape) * NOISE * np.sqrt(3)
    return room


def _sheet(size: tuple[float, float], triangles: int) -> trimesh.Trimesh:
    """Return a rectangle in the plane z = 0, normal up, of about so many triangles."""
    cell = np.sqrt(2 * size[0] * size[1] / triangles)
    across, along = (max(2, round(side / cell) + 1) for side in size)
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, across) * size[0], np.linspace(-0.5, 0.5, along) * size[1], indexing="ij")
    corner = np.arange(across * along).reshape(across, along)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return trimesh.Trimesh(np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3), faces, process=False)


@dataclass(frozen=True)
class Benchmark:
    """Time surroundings of several sizes, each in a process of its own; write docs/data and the table of the page."""

    triangles: tuple[int, ...] = (100_000, 500_000, 1_000_000, 2_000_000)
    """Sizes."""
    alone: bool = False
    """Time the first size in this process and print its figures as JSON."""
    write: bool = True
    """Write docs/data/large_surroundings.json and the table of docs/concepts/performance.md."""

    def run(self) -> None:
        """Print machine, versions and a line for each size."""
        if self.alone:
            print(json.dumps(measured(self.triangles[0])))
            return
        rows: list[dict[str, float]] = []
        for count in self.triangles:
            command = [sys.executable, __file__, "--alone", "--triangles", str(count)]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            rows.append(json.loads(done.stdout.splitlines()[-1]))
        content = {"machine": machine(), "versions": versions(), "rows": rows}
        shown = table("triangles", *(header for header, _ in list(COLUMNS.values())[1:]))
        for row in rows:
            shown.add_row(*cells(row))
        console = stdout()
        console.print("; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items()), soft_wrap=True)
        console.print(shown)
        if self.write:
            DATA.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
            write_page(content)


def measured(triangles: int) -> dict[str, float]:
    """Return the figures of one size: seconds by stage, megabytes, triangles."""
    hand, phone = load_hand("shadow_lite"), builtin_object("phone")
    sampler = Sampler(hand)
    sampler.sample(build_scene("table", phone, seed=0), num=32)  # kernels and weights
    found: dict[str, float] = {}

    def timed(stage: str, work: Callable[[], Any]) -> Any:
        start = time.perf_counter()
        result = work()
        found[stage] = time.perf_counter() - start
        return result

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "room.ply"
        room = scanned_room(triangles)
        room.export(path)
        found |= {"triangles": len(room.faces), "file_mb": path.stat().st_size / 1e6}
        del room
        found["base_mb"] = peak_memory_mb()
        environment = timed("load", lambda: load_environment(path))
        pose = place_at_rest(phone, 0.3).at(0.0, 0.0)
        scene = timed(
            "scene", lambda: Scene.from_files(phone, environment=environment, object_pose=pose, motion=[1, 0, 0])
        )
        samples = sampler.sample(scene, num=32)
        timed("save", lambda: scene.save(Path(folder) / "scene"))
    found |= {stage: samples.seconds[stage] for stage in ("prepare", "verify", "rank")}
    found |= {"kept": len(scene.environment_mesh.faces), "verified": samples.num_verified, "peak_mb": peak_memory_mb()}
    return found


def cells(row: dict[str, float]) -> list[str]:
    """Return a size's figures as text, in the order of the columns."""
    return [f"{row[key]:,.{digits}f}" for key, (_, digits) in COLUMNS.items()]


def write_page(content: dict[str, Any]) -> None:
    """Put the table into the page, between its marks."""
    header = [title for title, _ in COLUMNS.values()]
    lines = [header, ["---:"] * len(header), *map(cells, content["rows"])]
    made = "; ".join(f"{key} {value}" for key, value in {**content["machine"], **content["versions"]}.items())
    text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    page = PAGE.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    PAGE.write_text(f"{before}{BEGIN}\n{text}\n\nMade with {made}.\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
