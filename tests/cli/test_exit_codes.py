"""0 done, 2 bad input with one message on stderr, 1 a bug with its traceback."""

import os
import signal
import subprocess
import sys

import pytest

from dexnudge.cli import main as entry
from dexnudge.cli.hand import HandCommand
from dexnudge.errors import InputError


def test_a_deliberate_error_is_one_line_on_stderr_and_exit_2(dexnudge, monkeypatch):
    monkeypatch.setattr(HandCommand, "run", _raise(InputError("what; expected; got; mend")))
    outcome = dexnudge("hand", "shadow_lite")
    assert (outcome.code, outcome.out, outcome.err) == (2, "", "dexnudge: what; expected; got; mend\n")


def test_ctrl_c_exits_130_without_a_traceback(dexnudge, monkeypatch):
    monkeypatch.setattr(HandCommand, "run", _raise(KeyboardInterrupt()))
    outcome = dexnudge("hand", "shadow_lite")
    message = "dexnudge: interrupted; `dexnudge hand shadow_lite` goes on from where it stopped\n"
    assert (outcome.code, outcome.err) == (130, message)


def test_a_bug_passes_through_with_its_traceback(dexnudge, monkeypatch):
    monkeypatch.setattr(HandCommand, "run", _raise(ZeroDivisionError("steered_noise")))
    with pytest.raises(ZeroDivisionError, match="steered_noise"):
        dexnudge("hand", "shadow_lite")


def test_the_process_exits_1_on_a_bug():
    code = (
        "from dexnudge.cli import main\nfrom dexnudge.cli.hand import HandCommand\nimport sys\n"
        "HandCommand.run = lambda self: 1 // 0\nsys.argv = ['dexnudge', 'hand', 'x']\nmain.run()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 1
    assert done.stderr.endswith("ZeroDivisionError: integer division or modulo by zero\n")


def test_sigterm_unwinds_like_an_exception(tmp_path):
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
    assert os.listdir(tmp_path) == []


def _raise(error: BaseException):
    def run(_self):
        raise error

    return run
