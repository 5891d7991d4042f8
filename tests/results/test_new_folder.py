"""An output folder appears complete or not at all."""

import errno
import os
import subprocess
import sys

import pytest

from dexnudge.errors import InputError, OutputError
from dexnudge.jobs.folders import new_folder

MARKER = "marker.json"


def write(folder, text="new"):
    (folder / MARKER).write_text(text)
    (folder / "sub").mkdir()


def test_a_folder_and_its_parents_appear_at_the_end(tmp_path):
    out = tmp_path / "a" / "b" / "out"
    with new_folder(out, marker=MARKER) as folder:
        write(folder)
        assert not out.exists()
        assert folder.parent == out.parent
    assert sorted(os.listdir(out)) == [MARKER, "sub"]
    assert os.listdir(out.parent) == ["out"]


@pytest.mark.parametrize("error", [InputError("bad"), KeyboardInterrupt(), SystemExit(143), ZeroDivisionError()])
def test_whatever_stops_the_block_leaves_nothing_behind(tmp_path, error):
    with pytest.raises(type(error)), new_folder(tmp_path / "a" / "out", marker=MARKER) as folder:
        write(folder)
        raise error
    assert os.listdir(tmp_path) == []


def test_an_existing_folder_is_refused(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(OutputError) as caught, new_folder(out, marker=MARKER):
        pytest.fail("the block must not begin")
    assert str(caught.value) == (
        f"the output folder {out} exists; expected a new one; choose another --out, or replace it with --overwrite"
    )


def test_overwrite_replaces_a_folder_of_ours_and_only_when_done(tmp_path):
    out = tmp_path / "out"
    with new_folder(out, marker=MARKER) as folder:
        write(folder, "old")
    with pytest.raises(InputError), new_folder(out, overwrite=True, marker=MARKER) as folder:
        raise InputError("bad")
    assert (out / MARKER).read_text() == "old"
    with new_folder(out, overwrite=True, marker=MARKER) as folder:
        (folder / MARKER).write_text("new")
    assert (out / MARKER).read_text() == "new"
    assert os.listdir(out) == [MARKER]
    assert os.listdir(tmp_path) == ["out"]


def test_overwrite_never_deletes_a_folder_that_is_not_ours(tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.tex").write_text("years")
    with (
        pytest.raises(OutputError, match=r"has no marker\.json"),
        new_folder(tmp_path / "home", overwrite=True, marker=MARKER),
    ):
        pytest.fail("the block must not begin")
    assert (tmp_path / "home" / "thesis.tex").read_text() == "years"


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_file_or_a_link_in_the_place_of_the_folder_is_refused(tmp_path, overwrite):
    (tmp_path / "file").write_text("x")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for name in ("file", "link"):
        with (
            pytest.raises(OutputError, match="is not a folder"),
            new_folder(tmp_path / name, overwrite=overwrite, marker=MARKER),
        ):
            pytest.fail("the block must not begin")


def test_a_place_that_cannot_be_written_is_an_output_error(tmp_path):
    (tmp_path / "file").write_text("x")
    with (
        pytest.raises(OutputError, match="cannot write the output folder"),
        new_folder(tmp_path / "file" / "out", marker=MARKER),
    ):
        pytest.fail("the block must not begin")


def test_a_full_disk_is_an_output_error_and_leaves_nothing(tmp_path):
    with pytest.raises(OutputError, match="No space left"), new_folder(tmp_path / "out", marker=MARKER) as folder:
        write(folder)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert os.listdir(tmp_path) == []


def test_a_missing_input_file_is_no_output_error(tmp_path):
    with pytest.raises(FileNotFoundError), new_folder(tmp_path / "out", marker=MARKER):
        (tmp_path / "input.obj").read_text()
    assert os.listdir(tmp_path) == []


def test_a_real_limit_on_file_size_is_reported_and_cleaned_up(tmp_path):
    code = (
        "import resource, signal, sys\nfrom dexnudge.errors import OutputError\n"
        "from dexnudge.jobs.folders import new_folder\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try:\n"
        f"    with new_folder({str(tmp_path / 'out')!r}, marker='m') as folder:\n"
        "        (folder / 'large').write_bytes(bytes(5000))\n"
        "except OutputError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=True)
    assert "File too large" in done.stdout
    assert os.listdir(tmp_path) == []
