"""A real run of the command, killed in every way: nothing is lost, nothing twice, and the bytes are the same."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dexnudge.dataset.manifest import read_manifest
from dexnudge.jobs.folders import TEMPORARY_PREFIX

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="finds processes in /proc"),
]
PATIENCE = 240.0  # [s] for a step of a run on a busy machine
CLOUD_FITS_NOT = 8192  # bytes: room for a manifest, not for a file of surface points


@pytest.fixture
def start(objects, config, tmp_path):
    """Starts the command on the folder `out`, in a session of its own."""

    def popen(out: Path, *options: str, file_size: int | None = None) -> subprocess.Popen:
        def limit() -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_size, file_size))

        arguments = ["--objects", objects, "--out", out, "--seed", 4, *options]
        arguments += ["--hand", config.hand, "--non-prehensile", config.non_prehensile, "--grasps", config.grasps]
        return subprocess.Popen(
            [sys.executable, "-m", "dexnudge", "dataset", "generate", *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=limit if file_size else None,  # noqa: PLW1509  no threads have been started by then
        )

    return popen


def finish(process: subprocess.Popen) -> tuple[int, str]:
    _, message = process.communicate(timeout=PATIENCE)
    return process.returncode, message


def wait_for(process: subprocess.Popen, ready) -> None:
    deadline = time.monotonic() + PATIENCE
    while not (is_ready := ready()) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    assert process.poll() is None
    assert is_ready


def processes(command: str, parent: int | None = None) -> list[int]:
    """Running processes whose command line holds `command`."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            arguments = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            above = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
        except (FileNotFoundError, ProcessLookupError):  # it has ended meanwhile
            continue
        if command in arguments and parent in (None, above):
            found.append(int(folder.name))
    return found


def shards(out: Path) -> set[str]:
    return {path.name for path in out.glob("shard-*.parquet")}


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_stop_in_the_middle_changes_no_byte(start, tmp_path, data, names, files_of, how):
    out = tmp_path / "out"
    process = start(out, "--workers", "1")
    wait_for(process, lambda: len(shards(out)) == 1)
    os.killpg(process.pid, how) if how == signal.SIGINT else process.send_signal(how)
    code, message = finish(process)
    assert code == {signal.SIGKILL: -9, signal.SIGINT: 130}[how]
    assert "Traceback" not in message
    assert len(shards(out)) == 1
    (out / f"{TEMPORARY_PREFIX}1-shard-bar.parquet").write_bytes(b"half")  # of a worker killed as it wrote
    (first,) = out.glob("shard-*.parquet")
    before = first.stat().st_mtime_ns
    assert finish(start(out, "--workers", "2"))[0] == 0
    assert files_of(out) == files_of(data)
    assert first.stat().st_mtime_ns == before
    assert not list(out.glob(f"{TEMPORARY_PREFIX}*"))


def test_a_killed_worker_costs_one_object_which_the_next_start_makes(start, tmp_path, data, names, files_of):
    out = tmp_path / "out"
    process = start(out, "--workers", "1")
    wait_for(process, lambda: len(shards(out)) == 1)
    (worker,) = processes("spawn_main", parent=process.pid)
    os.kill(worker, signal.SIGKILL)
    code, message = finish(process)
    assert code == 0
    failed = read_manifest(out).failed_objects
    (lost,) = set(failed) - {"broken"}
    assert failed[lost] == "its worker process died (exit code -9), for example for want of memory"
    assert f"object {lost} failed: its worker process died" in message
    assert len(shards(out)) == 1
    assert finish(start(out, "--workers", "1"))[0] == 0
    assert files_of(out) == files_of(data)


def test_a_full_disk_is_one_clear_error_and_no_loss(start, tmp_path, data, files_of):
    out = tmp_path / "out"
    code, message = finish(start(out, "--workers", "2", file_size=CLOUD_FITS_NOT))
    assert code == 2
    assert "Traceback" not in message
    last = message.strip().splitlines()[-1]
    assert last.startswith(f"dexnudge: cannot write {out.resolve()}/object-")
    assert last.endswith(
        f"0 of 3 objects are complete and safe in {out}; make room, then give the same command again: it goes on with "
        "the others."
    )
    assert set(files_of(out)) == {"manifest.json"}
    assert not list(out.glob(f"{TEMPORARY_PREFIX}*"))
    assert finish(start(out, "--workers", "1"))[0] == 0
    assert files_of(out) == files_of(data)


def kill_a_busy_ray_worker() -> bool:
    """Kills one that has been at a task for half a second; False if none has been."""
    before = processes("ray::_answer")  # Ray writes the name of a task into its worker's title
    time.sleep(0.5)
    busy = sorted(set(before) & set(processes("ray::_answer")))
    if busy:
        os.kill(busy[0], signal.SIGKILL)
    return bool(busy)


def test_a_ray_cluster_gives_the_same_bytes_though_a_worker_is_killed(start, tmp_path, data, names, files_of):
    pytest.importorskip("ray")
    out = tmp_path / "out"
    process = start(out, "--engine", "ray", "--workers", "2")

    wait_for(process, kill_a_busy_ray_worker)
    code, message = finish(process)
    assert code == 0, message
    assert set(read_manifest(out).failed_objects) == {"broken"}
    assert files_of(out) == files_of(data)
