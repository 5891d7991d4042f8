"""Arrays on disk: the same values as freshly built, whatever the folder holds and whoever else writes to it."""

import json
import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dexnudge.energies.kernel_inputs import build_scene_fields
from dexnudge.geometry import disk_cache
from dexnudge.geometry import distance_grid as grids
from dexnudge.geometry import surface_points as points_module
from dexnudge.geometry.disk_cache import cache_folder, cached_array
from dexnudge.geometry.distance_grid import DistanceGrid, cached_distance_grid, distance_grid
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_points import cached_surface_points, surface_points

CELL = 0.004  # [m]
MESH = trimesh.creation.icosphere(subdivisions=2, radius=0.03)


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """An empty cache, switched on."""
    monkeypatch.delenv("DEXNUDGE_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "dexnudge" / "grids"


def ask(mesh: trimesh.Trimesh = MESH, *, cell: float = CELL, padding: float = 0.005) -> DistanceGrid:
    lower, upper = mesh.bounds
    return cached_distance_grid(mesh, lower - padding, upper + padding, cell=cell)


def build(mesh: trimesh.Trimesh = MESH, *, cell: float = CELL, padding: float = 0.005) -> DistanceGrid:
    lower, upper = mesh.bounds
    return distance_grid(ExactDistance(mesh), lower - padding, upper + padding, cell=cell)


def assert_same(one: DistanceGrid, other: DistanceGrid) -> None:
    """To the last bit, which is more than equal: it tells 0.0 from -0.0."""
    assert one.values.dtype == other.values.dtype
    assert one.values.shape == other.values.shape
    assert one.values.tobytes() == other.values.tobytes()
    assert one.origin.tobytes() == other.origin.tobytes()
    assert one.cell == other.cell


def the_file(folder: Path) -> Path:
    (file,) = folder.iterdir()
    return file


@pytest.fixture
def no_building(monkeypatch):
    """From here on a grid must come from the cache."""

    def forbid():
        monkeypatch.setattr(grids, "ExactDistance", lambda *_, **__: pytest.fail("a grid is built again"))

    return forbid


def test_the_second_time_it_is_read_and_the_same_to_the_last_bit(folder, no_building):
    expected = build()
    assert_same(ask(), expected)
    no_building()
    assert_same(ask(), expected)


def test_the_fields_of_a_scene_read_the_object_s_grid(folder, no_building):
    box = trimesh.creation.box((0.03, 0.02, 0.01))
    first = build_scene_fields(box, None)
    no_building()
    again = build_scene_fields(box, None)
    assert first.grids.values.numpy().tobytes() == again.grids.values.numpy().tobytes()


def test_surface_points_are_read_and_the_same_to_the_last_bit(folder, monkeypatch):
    expected = surface_points(MESH, spacing=0.004, seed=3)
    cached_surface_points(MESH, spacing=0.004, seed=3)
    monkeypatch.setattr(points_module, "surface_points", lambda *_, **__: pytest.fail("points are made again"))
    found = cached_surface_points(MESH, spacing=0.004, seed=3)
    assert found.points.tobytes() == expected.points.tobytes()
    assert found.normals.tobytes() == expected.normals.tobytes()


def test_points_of_a_mesh_with_other_normals_are_others(folder):
    tilted = trimesh.Trimesh(MESH.vertices, MESH.faces, vertex_normals=-MESH.vertex_normals, process=False)
    own = cached_surface_points(MESH, spacing=0.004)
    others = cached_surface_points(tilted, spacing=0.004)
    assert own.normals.tobytes() != others.normals.tobytes()
    assert others.normals.tobytes() == surface_points(tilted, spacing=0.004).normals.tobytes()


def test_reading_takes_the_file_and_the_array_and_no_copies(folder):
    made = np.zeros(2**20)
    cached_array("zeros", [], lambda: made)
    tracemalloc.start()
    try:
        assert (cached_array("zeros", [], lambda: 1 / 0) == made).all()
        assert tracemalloc.get_traced_memory()[1] < 2.5 * made.nbytes
    finally:
        tracemalloc.stop()


def test_its_file_is_plain_numpy(folder):
    grid = ask()
    np.testing.assert_array_equal(np.load(the_file(folder), allow_pickle=False), grid.values)


def test_what_changes_the_values_changes_the_file(folder):
    moved = MESH.copy()
    moved.vertices[0] += 1e-9
    turned = MESH.copy()
    turned.faces = turned.faces[:, ::-1]
    for grid, expected in (
        (ask(), build()),
        (ask(cell=0.005), build(cell=0.005)),
        (ask(padding=0.006), build(padding=0.006)),
        (ask(moved), build(moved)),
        (ask(turned), build(turned)),
    ):
        assert_same(grid, expected)
    assert len(list(folder.iterdir())) == 5


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[: len(content) // 2],
        lambda content: content[:-1],
        lambda content: b"something else altogether",
        lambda content: bytes(len(content)),
        lambda content: content[:200] + bytes([content[200] ^ 1]) + content[201:],
    ],
    ids=["empty", "half", "last byte gone", "foreign", "zeros", "one bit"],
)
def test_a_damaged_file_is_built_again_and_replaced(folder, damage):
    expected = ask()
    file = the_file(folder)
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    assert_same(ask(), expected)
    assert the_file(folder).read_bytes() == whole


def test_the_file_of_another_grid_is_not_taken(folder):
    expected = ask()
    file = the_file(folder)
    ask(cell=0.005)
    (other,) = set(folder.iterdir()) - {file}
    file.write_bytes(other.read_bytes())
    assert_same(ask(), expected)


def test_a_folder_that_cannot_be_made_is_done_without(folder):
    folder.parent.parent.joinpath("dexnudge").write_text("a file where the folder should be")
    assert_same(ask(), build())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full: Linux only")
def test_a_full_disk_is_done_without_and_leaves_nothing(folder, monkeypatch):
    def full(handle: int, _: str):
        os.close(handle)
        return Path("/dev/full").open("wb", buffering=0)

    monkeypatch.setattr(disk_cache.os, "fdopen", full)
    assert_same(ask(), build())
    assert list(folder.iterdir()) == []


def test_switched_off_it_leaves_no_trace(folder, monkeypatch):
    monkeypatch.setenv("DEXNUDGE_CACHE", "off")
    assert cache_folder() is None
    assert_same(ask(), build())
    assert not folder.parent.exists()


def test_it_lies_in_the_folder_that_is_named_by_an_absolute_path(folder, monkeypatch, tmp_path):
    monkeypatch.setenv("DEXNUDGE_CACHE", str(tmp_path / "mine"))
    assert cache_folder() == tmp_path / "mine"
    monkeypatch.setenv("DEXNUDGE_CACHE", "relative/path")
    assert cache_folder() == folder


def test_without_a_cache_home_it_lies_in_the_home(folder, monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for unusable in ("", "relative/path"):
        monkeypatch.setenv("XDG_CACHE_HOME", unusable)
        assert cache_folder() == Path.home() / ".cache" / "dexnudge" / "grids"


def test_beyond_the_limit_what_was_unused_for_longest_goes(folder, monkeypatch):
    cells = [0.004, 0.005, 0.006]
    names = []
    for age, cell in enumerate(cells):
        before = set(folder.iterdir()) if folder.exists() else set()
        ask(cell=cell)
        (file,) = set(folder.iterdir()) - before
        os.utime(file, (1000 + age, 1000 + age))
        names.append(file)
    ask(cell=cells[0])  # read: now the youngest
    monkeypatch.setattr(disk_cache, "LARGEST_CACHE", sum(file.stat().st_size for file in names))
    ask(cell=0.0045)
    left = set(folder.iterdir())
    assert names[0] in left
    assert names[1] not in left
    assert sum(file.stat().st_size for file in left) <= disk_cache.LARGEST_CACHE


WRITER = """
import json, sys
from pathlib import Path
import numpy as np
from dexnudge.geometry.disk_cache import _read, _write
file, values = Path(sys.argv[1]), np.arange(300_000, dtype=np.float32).reshape(100, 60, 50)
print("ready", flush=True)
sys.stdin.readline()
whole = 0
for _ in range(40):
    _write(file, values)
    found = _read(file)
    whole += found is not None and found.tobytes() == values.tobytes()
print(json.dumps(whole))
"""


def test_two_processes_that_write_the_same_grid_never_find_half_of_it(folder):
    file = folder / "same.npy"
    writers = [
        subprocess.Popen(
            [sys.executable, "-c", WRITER, str(file)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    for writer in writers:
        assert writer.stdout.readline() == "ready\n"
    for writer in writers:
        writer.stdin.write("go\n")
        writer.stdin.flush()
    found = [writer.communicate(timeout=60)[0] for writer in writers]
    assert [json.loads(text) for text in found] == [40, 40]
    assert list(folder.iterdir()) == [file]


def test_what_others_keep_in_the_folder_stays(folder, monkeypatch):
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("thesis.tar", "own.npy"):
        (folder / name).write_bytes(bytes(1000))
        os.utime(folder / name, (0, 0))
    monkeypatch.setattr(disk_cache, "LARGEST_CACHE", 600)  # two of the three arrays
    for number in range(3):
        cached_array("test", [np.array([number])], lambda: np.zeros(100, dtype=np.uint8))
    assert {"thesis.tar", "own.npy"} < {file.name for file in folder.iterdir()}
    assert len(list(folder.iterdir())) == 4
