"""Ctrl-C while a library is busy, and while it is not."""

import signal
import subprocess
import sys

import pytest

BUSY = "hashlib.pbkdf2_hmac('sha256', b'', b'', 2**31 - 1)"  # takes an hour, and asks for no signals
CODE = """
import hashlib, sys
from dexnudge.cli.main import ended_after_signal
try:
    with ended_after_signal("go on like this", seconds={seconds}):
        try:
            print("ready", flush=True)
            {work}
        except KeyboardInterrupt:  # where the signal is faster than the work
            {then}
except KeyboardInterrupt:
    sys.exit("by itself")
"""


def ended(code: str, number: signal.Signals) -> tuple[int, str]:
    running = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with running:
        assert running.stdout.readline() == "ready\n"
        running.send_signal(number)
        _, said = running.communicate(timeout=600)
    return running.returncode, said


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_call_that_hears_nothing_is_ended_with_what_to_type():
    assert ended(CODE.format(seconds=0.0, work=BUSY, then=BUSY), signal.SIGINT) == (130, "go on like this\n")


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_what_ends_by_itself_is_left_to_it():
    code, said = ended(CODE.format(seconds=3600.0, work="import time; time.sleep(3600)", then="raise"), signal.SIGINT)
    assert (code, said) == (1, "by itself\n")
