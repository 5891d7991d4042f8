"""Files appear whole or not at all."""

import subprocess
import sys

import pytest

from dexnudge.errors import OutputError
from dexnudge.jobs.atomic_files import TEMPORARY_PREFIX, remove_leftovers, replace_atomically


def test_a_failing_writer_keeps_the_old_file_and_leaves_nothing(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")
    with pytest.raises(UnicodeEncodeError), replace_atomically(path) as temporary:
        temporary.write_text("new\ud800", encoding="utf-8")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]  # `open` had created the temporary file


def test_a_killed_writer_keeps_the_old_file_and_its_leftover_can_be_cleared(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")
    script = (
        "import os, signal, sys\n"
        "from dexnudge.jobs.atomic_files import replace_atomically\n"
        "with replace_atomically(sys.argv[1]) as temporary:\n"
        "    temporary.write_text('half of the n')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    killed = subprocess.run([sys.executable, "-c", script, str(path)], check=False)
    assert killed.returncode == -9
    assert path.read_text() == "old"
    assert [file.name.startswith(TEMPORARY_PREFIX) for file in sorted(tmp_path.iterdir())] == [True, False]
    assert len(remove_leftovers(tmp_path)) == 1
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_cannot_be_written_is_an_output_error(tmp_path):
    (tmp_path / "folder").write_text("a file where a folder should be")
    with (
        pytest.raises(OutputError, match=r"cannot write .*; expected a writable folder"),
        replace_atomically(tmp_path / "folder" / "file"),
    ):
        pass
