"""`dexnudge view`: what it refuses, what it says, and that Ctrl-C ends it."""

import re
import signal
import subprocess
import sys
from unittest.mock import Mock
from urllib.request import urlopen

import pytest

pytest.importorskip("viser")


def test_without_viser_one_message_says_what_to_install(dexnudge, monkeypatch):
    monkeypatch.setattr("dexnudge.cli.view.find_spec", lambda name: None)
    outcome = dexnudge("view")
    assert outcome.code == 2
    assert outcome.err == (
        "dexnudge: the studio needs the package viser, which is not installed; expected it; mend it with: "
        "pip install 'dexnudge[studio]'\n"
    )


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nowhere"], "holds neither"),
        (["--execution", "x"], "--execution is given without a result folder"),
        (["--host", "192.0.2.1", "--port", "0"], "cannot listen at --host '192.0.2.1'"),
        (["--host", "a" * 300], "expected an address of this machine"),
        ([f"--host={'a' * 300}"], "cannot listen at --host 'aaa"),
        (["--port", "70000"], "--port is 70000; expected at most 65535"),
    ],
)
def test_what_cannot_be_opened_is_refused_in_one_line(dexnudge, tmp_path, monkeypatch, arguments, says):
    monkeypatch.chdir(tmp_path)
    outcome = dexnudge("view", *arguments)
    assert outcome.code == 2
    assert says in outcome.err
    assert outcome.err.count("\n") == 1


@pytest.mark.parametrize(
    ("waiting", "closing", "code"),
    [
        ([SystemExit(143)], [], 143),  # SIGTERM
        ([], [], 0),  # Ctrl-C
        ([], [KeyboardInterrupt], 0),  # twice
        ([KeyboardInterrupt], [SystemExit(143)], 143),
    ],
)
def test_draws_under_way_change_nothing_of_the_exit_code(dexnudge, monkeypatch, waiting, closing, code):
    studio = Mock(url="", port=8080)
    exits = []
    monkeypatch.setattr("dexnudge.studio.studio.Studio", lambda *_, **__: studio)
    monkeypatch.setattr("os._exit", exits.append)
    for working in (False, True):
        studio.session.working = working
        studio.wait.side_effect, studio.close.side_effect = waiting or None, closing or None
        assert dexnudge("view").code == code
        assert exits == ([code] if working else [])  # Python would abort if it ended around compiled code


@pytest.mark.slow
def test_interrupted_it_ends_cleanly(sampled, tmp_path):
    command = [sys.executable, "-u", "-m", "dexnudge", "view", str(sampled), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    address = re.search(r"http://127\.0\.0\.1:\d+", process.stdout.readline())[0]
    assert b"viser" in urlopen(address, timeout=30).read()  # noqa: S310 - our own address
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0
    assert errors == ""
