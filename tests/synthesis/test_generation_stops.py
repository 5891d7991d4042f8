"""A real run of the command, killed in every way: nothing is lost, nothing twice, and the bytes are the same.

A worker that comes to the second object says so and waits there, so that every kill meets the run at the same place.
"""

import os
import resource
import select
import signal
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from dexnudge.dataset.manifest import read_manifest
from dexnudge.jobs.atomic_files import TEMPORARY_PREFIX
from dexnudge.synthesis.generate import generate_dataset

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="processes meet at a named pipe")]
PATIENCE = 300.0  # [s] until a run that hangs fails its test
CLOUD_FITS_NOT = 8192  # bytes: room for a manifest, not for a file of surface points
# Workers are spawned: each imports this script, which is their main module, and with it the gate.
GATED_COMMAND = """
import os, signal, sys
from dexnudge.synthesis.object_data import ObjectTask

generate = ObjectTask.__call__

def wait_at_the_gate(task, entry):
    if entry.name == {gated!r}:
        with open({gate!r}, "w") as gate:
            gate.write(f"{{os.getpid()}}\\n")
        signal.pause()
    return generate(task, entry)

ObjectTask.__call__ = wait_at_the_gate
if __name__ == "__main__":
    from dexnudge.cli.main import main
    sys.exit(main())
"""


@pytest.fixture
def out(tmp_path) -> Path:
    return tmp_path / "out"


@pytest.fixture
def options(objects, config, out) -> list[str]:
    """Those of the run that made `data`."""
    options = ["dataset", "generate", "--objects", objects, "--out", out, "--seed", 4, "--hand", config.hand]
    return [*map(str, options), "--non-prehensile", str(config.non_prehensile), "--grasps", str(config.grasps)]


@pytest.fixture
def resume(objects, config, out):
    """Goes on with the run in this process, with one worker."""
    return lambda: generate_dataset(str(objects), out, config, seed=4, workers=1)


@pytest.fixture
def at_the_gate(options, names, tmp_path):
    """A run in a session of its own whose only worker waits before the second object, and that worker's number."""
    gated = sorted(names, key=lambda name: zlib.crc32(name.encode()))[1]  # in the order of generation
    gate, script = tmp_path / "gate", tmp_path / "gated.py"
    os.mkfifo(gate)
    script.write_text(GATED_COMMAND.format(gated=gated, gate=str(gate)))
    reader = os.open(gate, os.O_RDONLY | os.O_NONBLOCK)
    process = subprocess.Popen(
        [sys.executable, script, *options, "--workers", "1"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        arrived, _, _ = select.select([reader], [], [], PATIENCE)
        assert arrived, process.communicate()
        yield process, int(os.read(reader, 100)), gated
    finally:
        os.close(reader)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def finish(process: subprocess.Popen) -> tuple[int, str]:
    _, message = process.communicate(timeout=PATIENCE)
    return process.returncode, message


def shards(out: Path) -> list[Path]:
    return list(out.glob("shard-*.parquet"))


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_stop_in_the_middle_changes_no_byte(at_the_gate, out, resume, data, files_of, how):
    process, _, _ = at_the_gate
    os.killpg(process.pid, how) if how == signal.SIGINT else process.send_signal(how)
    code, message = finish(process)
    assert code == {signal.SIGKILL: -9, signal.SIGINT: 130}[how]
    assert "Traceback" not in message
    (first,) = shards(out)
    (out / f"{TEMPORARY_PREFIX}1-shard-bar.parquet").write_bytes(b"half")  # of a worker killed as it wrote
    before = first.stat().st_mtime_ns
    resume()
    assert files_of(out) == files_of(data)
    assert first.stat().st_mtime_ns == before
    assert not list(out.glob(f"{TEMPORARY_PREFIX}*"))


def test_a_killed_worker_costs_one_object_which_the_next_start_makes(at_the_gate, out, resume, data, files_of):
    process, worker, lost = at_the_gate
    os.kill(worker, signal.SIGKILL)
    code, message = finish(process)
    assert code == 0
    failed = read_manifest(out).failed_objects
    assert set(failed) == {"broken", lost}
    assert failed[lost] == "its worker process died (exit code -9), for example for want of memory"
    assert f"object {lost} failed: its worker process died" in message
    assert len(shards(out)) == 1
    resume()
    assert files_of(out) == files_of(data)


def test_a_full_disk_is_one_clear_error_and_no_loss(options, out, resume, data, files_of):
    process = subprocess.Popen(
        [sys.executable, "-m", "dexnudge", *options, "--workers", "2"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (CLOUD_FITS_NOT, CLOUD_FITS_NOT)),  # noqa: PLW1509
    )
    code, message = finish(process)
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
    resume()
    assert files_of(out) == files_of(data)


def test_a_ray_cluster_gives_the_same_bytes(options, out, data, files_of):
    pytest.importorskip("ray")
    process = subprocess.run(
        [sys.executable, "-m", "dexnudge", *options, "--engine", "ray", "--workers", "2"],
        check=False,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert process.returncode == 0, process.stderr
    assert set(read_manifest(out).failed_objects) == {"broken"}
    assert files_of(out) == files_of(data)
