"""0 done, 2 bad input with one message on stderr, 1 a bug with its traceback."""

import errno
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from dexnudge.cli import main as entry
from dexnudge.cli.benchmark import ScoreBenchmark
from dexnudge.cli.hand import HandCommand
from dexnudge.errors import InputError
from dexnudge.geometry import devices


def test_a_deliberate_error_is_one_line_on_stderr_and_exit_2(dexnudge, monkeypatch):
    monkeypatch.setattr(HandCommand, "run", _raise(InputError("what; expected; got; mend")))
    outcome = dexnudge("hand", "shadow_lite")
    assert (outcome.code, outcome.out, outcome.err) == (2, "", "dexnudge: what; expected; got; mend\n")


@pytest.mark.parametrize(
    ("command", "going_on"),
    [
        ("hand shadow_lite", "starts again; what stood before is as it was"),
        ("hand shadow_lite --learn --out x", "goes on from where it stopped"),
        ("hand shadow_lite --learn", "goes on from where it stopped"),
        ("benchmark score entry --suite s --out x", "goes on from where it stopped"),
        ("benchmark score entry --suite s --out=x", "goes on from where it stopped"),
        ("benchmark score entry --suite s --out new", "starts again; what stood before is as it was"),
        ("benchmark score entry --suite s --out=new", "starts again; what stood before is as it was"),
    ],
)
def test_ctrl_c_exits_130_without_a_traceback(dexnudge, monkeypatch, tmp_path, command, going_on):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x").mkdir()
    for kind in (HandCommand, ScoreBenchmark):
        monkeypatch.setattr(kind, "run", _raise(KeyboardInterrupt()))
    outcome = dexnudge(*command.split())
    assert (outcome.code, outcome.err) == (130, f"dexnudge: interrupted; `dexnudge {command}` {going_on}\n")


def test_a_bug_passes_through_with_its_traceback(dexnudge, monkeypatch):
    monkeypatch.setattr(HandCommand, "run", _raise(ZeroDivisionError("steered_noise")))
    with pytest.raises(ZeroDivisionError, match="steered_noise"):
        dexnudge("hand", "shadow_lite")


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "no more was given"),
        (MemoryError("Unable to allocate 8 GiB"), "Unable to allocate 8 GiB"),
        (RuntimeError("x: DefaultCPUAllocator: can't allocate memory: 9 bytes\nmore"), "9 bytes"),
        (RuntimeError("can't start new thread"), "can't start new thread"),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "[Errno 12] Cannot allocate memory"),
    ],
)
def test_a_lack_of_memory_is_one_line(dexnudge, monkeypatch, error, said):
    monkeypatch.setattr(HandCommand, "run", _raise(error))
    outcome = dexnudge("hand", "shadow_lite")
    assert outcome.code == 2
    assert outcome.err.startswith("dexnudge: ran out of memory (")
    assert outcome.err.endswith(f"{said}); free some, raise its limit, or ask for less\n")


def test_a_small_limit_of_address_space_is_refused_before_libraries_are_loaded(tmp_path):
    command = f"ulimit -v 1500000; exec {sys.executable} -m dexnudge sample phone --out {tmp_path / 'out'}"
    done = subprocess.run(["/bin/bash", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "dexnudge: the address space of this process is limited to 1.54 GB; expected at least 2.1 GB; raise the limit with "
        "`ulimit -v unlimited`\n"
    )


def test_memory_that_is_free_stays_below_the_limit_of_address_space(monkeypatch):
    before = devices.free_memory("cpu")
    monkeypatch.setattr(resource, "getrlimit", lambda _: (10**12, -1))
    assert devices.free_memory("cpu") == pytest.approx(before, rel=0.2)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (1, -1))
    assert devices.free_memory("cpu") < 0


def test_the_process_exits_1_on_a_bug():
    code = (
        "from dexnudge.cli import main\nfrom dexnudge.cli.hand import HandCommand\nimport sys\n"
        "HandCommand.run = lambda self: 1 // 0\nsys.argv = ['dexnudge', 'hand', 'x']\nmain.run()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 1
    assert done.stderr.endswith("ZeroDivisionError: integer division or modulo by zero\n")


def test_sigterm_unwinds_like_an_exception_and_says_what_to_type(tmp_path):
    code = (
        "import os, signal, sys\nfrom dexnudge.cli import main\nfrom dexnudge.cli.hand import HandCommand\n"
        "from dexnudge.jobs.folders import new_folder\n"
        "def run(self):\n"
        f"    with new_folder({str(tmp_path / 'out')!r}, marker='m') as folder:\n"
        "        (folder / 'half').write_text('')\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "HandCommand.run = run\nsys.argv = ['dexnudge', 'hand', 'x']\nmain.run()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 128 + signal.SIGTERM == entry.TERMINATED
    assert done.stderr == "dexnudge: interrupted; `dexnudge hand x` starts again; what stood before is as it was\n"
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("again", [signal.SIGINT, signal.SIGTERM])
def test_a_second_signal_while_python_ends_is_no_traceback(again):
    code = (
        "import atexit, os, sys\nfrom dexnudge.cli import main\nfrom dexnudge.cli.hand import HandCommand\n"
        "def run(self):\n    raise KeyboardInterrupt\n"
        f"HandCommand.run = run\natexit.register(os.kill, os.getpid(), {int(again)})\n"
        "sys.argv = ['dexnudge', 'hand', 'x']\nmain.run()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == -again
    assert done.stderr == "dexnudge: interrupted; `dexnudge hand x` starts again; what stood before is as it was\n"


@pytest.mark.parametrize("arguments", [["--version"], ["plugins"]])
def test_a_reader_that_has_seen_enough_ends_the_command_quietly(arguments):
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "dexnudge", *arguments]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, "")


@pytest.mark.parametrize("arguments", ["check out", "sample phone --scene table"])
def test_a_working_directory_that_was_deleted_is_one_message(tmp_path, arguments):
    (tmp_path / "gone").mkdir()
    command = f"cd {tmp_path / 'gone'}; rmdir {tmp_path / 'gone'}; exec {sys.executable} -m dexnudge {arguments}"
    env = {**os.environ, "PYTHONPATH": str(Path(entry.__file__).parents[2])}
    done = subprocess.run(
        ["/bin/bash", "-c", command], env=env, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "dexnudge: the working directory cannot be found (No such file or directory); expected one that exists; change to "
        "another by `cd`\n"
    )


def test_a_line_end_in_a_name_does_not_reach_the_terminal(dexnudge):
    outcome = dexnudge("sample", "folder/no\nsuch.ply", "--scene", "table")
    assert outcome.code == 2
    assert outcome.err.startswith("dexnudge: folder/no_such.ply: the mesh file does not exist; ")
    assert outcome.err.count("\n") == 1


@pytest.mark.parametrize("arguments", ["--version", "--help", "sample --help", "plugins", "hand shadow_lite"])
def test_a_full_standard_output_is_one_message(arguments):
    command = [sys.executable, "-m", "dexnudge", *arguments.split()]
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr == (
        "dexnudge: cannot write to standard output: No space left on device; expected a terminal, a pipe, or a file on a "
        "disk with free space; what was not told of may be written all the same\n"
    )


@pytest.mark.parametrize(
    ("arguments", "closed", "code"),
    [
        ("--version", ">&-", 0),
        ("sample --help", ">&-", 0),
        ("hand shadow_lite", ">&-", 0),
        ("hand shadow_lite", "<&- >&- 2>&-", 0),
        ("check nothing", ">&-", 2),
        ("check nothing", "2>&-", 2),
    ],
)
def test_closed_streams_are_no_failure(arguments, closed, code):
    command = f"exec {sys.executable} -m dexnudge {arguments} {closed}"
    done = subprocess.run(["/bin/bash", "-c", command], capture_output=True, text=True, timeout=60, check=False)
    said = "dexnudge: nothing is not a folder" if code and closed != "2>&-" else ""
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr.startswith(said)
    assert bool(done.stderr) == bool(said)


def _raise(error: BaseException):
    def run(_self):
        raise error

    return run
