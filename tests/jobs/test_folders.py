"""An output folder has one owner, appears complete or not at all, and takes nobody's place."""

import errno
import os
import re
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from dexnudge.errors import InputError, OutputError, writing
from dexnudge.jobs.folders import free_folder, new_folder, owned_folder

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
        f"the output folder {out} exists; expected a new one; choose another `out`, or replace it with `overwrite`"
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
    assert os.listdir(tmp_path) == ["out"]


def test_overwrite_keeps_everything_that_such_an_output_does_not_consist_of(tmp_path):
    out = tmp_path / "out"
    for name in (MARKER, "old.txt", "notes.txt", "mesh/a.obj", "mesh/deep/b.obj", "mesh/mine.txt", "mine/summary.json"):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text("old")
    (out / "empty").mkdir()
    (out / "link").symlink_to("notes.txt")
    (out / "gone").symlink_to("nowhere")
    with new_folder(out, overwrite=True, marker=MARKER, ours=("*.txt", "mesh/*.obj")) as folder:
        (folder / MARKER).write_text("new")
        (out / "mine" / "later.txt").write_text("written while this ran")
    kept = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_symlink() or not path.is_dir()}
    assert kept == {MARKER, "link", "gone", "mesh/deep/b.obj", "mesh/mine.txt", "mine/summary.json", "mine/later.txt"}
    assert (out / "empty").is_dir()
    assert (out / "gone").readlink() == Path("nowhere")
    assert (out / MARKER).read_text() == "new"
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="a folder in which nobody can make a file, root included")
@pytest.mark.parametrize("make", [new_folder, owned_folder])
def test_a_place_where_no_file_can_be_made_is_an_output_error_and_not_waited_for(make):
    options = {"marker": MARKER} if make is new_folder else {}
    for out in ("/proc/x", "/proc/x/y"):
        with pytest.raises(OutputError, match=f"cannot write the output folder {out}"), make(out, **options):
            pytest.fail("the block must not begin")


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


@pytest.mark.parametrize("empty", [True, False])
def test_a_folder_that_appears_while_the_block_runs_stays_and_the_result_is_kept_beside_it(tmp_path, empty):
    out = tmp_path / "out"
    (tmp_path / "out-2").write_text("a file of somebody else")
    if empty:
        with new_folder(out, marker=MARKER) as folder:
            write(folder)
            out.mkdir()
        assert (out / MARKER).read_text() == "new"
        return
    with pytest.raises(OutputError) as caught, new_folder(out, marker=MARKER) as folder:
        write(folder)
        out.mkdir()
        (out / "thesis.tex").write_text("years")
    assert str(caught.value) == (
        f"something else appeared at the output folder {out} while this ran; expected nothing there; it is as it was, and "
        f"the result is complete in {tmp_path / 'out-3'}"
    )
    assert (out / "thesis.tex").read_text() == "years"
    assert sorted(os.listdir(tmp_path / "out-3")) == [MARKER, "sub"]
    assert sorted(os.listdir(tmp_path)) == ["out", "out-2", "out-3"]


def test_overwrite_does_not_replace_what_came_in_between(tmp_path):
    out = tmp_path / "out"
    with new_folder(out, marker=MARKER) as folder:
        write(folder, "old")
    with (
        pytest.raises(OutputError, match=r"complete in .*out-2$"),
        new_folder(out, overwrite=True, marker=MARKER) as folder,
    ):
        write(folder)
        (out / "execution").mkdir()
    assert sorted(os.listdir(out)) == ["execution", MARKER, "sub"]
    assert (out / MARKER).read_text() == "old"
    assert (tmp_path / "out-2" / MARKER).read_text() == "new"


HOLD = """
import sys
from dexnudge.jobs.folders import new_folder, owned_folder
with {enter} as folder:
    (folder / "file").write_text("half")
    print("holding", flush=True)
    sys.stdin.read()
"""


@contextmanager
def another_process(enter: str):
    """A process that holds a folder until it is told to go on or killed."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD.format(enter=enter)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with process:
        try:
            assert process.stdout.readline() == "holding\n"
            yield process
        finally:
            process.kill()


def new(out) -> str:
    return f"new_folder({str(out)!r}, overwrite=True, marker='file')"


def owned(out) -> str:
    return f"owned_folder({str(out)!r})"


def enter_refused(context) -> str:
    with pytest.raises(OutputError, match="is being written by") as caught, context:
        pytest.fail("the block must not begin")
    return str(caught.value)


@pytest.mark.parametrize("enter", [new, owned])
def test_the_second_owner_of_a_folder_is_refused_and_told_who_the_first_is(tmp_path, enter):
    out = tmp_path / "out"
    with another_process(enter(out)) as first:
        messages = [enter_refused(owned_folder(out))]
        if enter is new:
            messages.append(enter_refused(new_folder(out, overwrite=True, marker="file")))
            assert free_folder(out) == tmp_path / "out-2"
        for message in messages:
            assert re.fullmatch(
                rf"the output folder {out} is being written by process {first.pid} on {socket.gethostname()} since "
                r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d[+-]\d\d:\d\d \(-c\); expected one run at a time; wait for it to end, or "
                "choose another `out`",
                message,
            )
        first.communicate()
        assert first.returncode == 0
    assert os.listdir(tmp_path) == ["out"]
    assert os.listdir(out) == ["file"]
    with owned_folder(out):
        pass


@pytest.mark.parametrize("enter", [new, owned])
def test_a_killed_owner_owns_nothing_and_its_leftovers_go(tmp_path, enter):
    out = tmp_path / "out"
    with another_process(enter(out)) as first:
        first.kill()
        first.wait()
    if enter is owned:
        with owned_folder(out) as folder:
            assert (folder / "file").read_text() == "half"
        assert os.listdir(out) == ["file"]
    else:
        assert sorted(os.listdir(tmp_path)) == [".out.dexnudge-lock", ".out.partial"]
        with new_folder(out, marker=MARKER) as folder:
            assert os.listdir(folder) == []
            write(folder)
        assert sorted(os.listdir(out)) == [MARKER, "sub"]
    assert os.listdir(tmp_path) == ["out"]


def test_what_a_run_killed_while_it_replaced_a_folder_had_set_aside_comes_back(tmp_path):
    (tmp_path / ".out.replaced").mkdir()
    (tmp_path / ".out.replaced" / MARKER).write_text("old")
    with pytest.raises(OutputError, match="exists"), new_folder(tmp_path / "out", marker=MARKER):
        pytest.fail("the block must not begin")
    assert (tmp_path / "out" / MARKER).read_text() == "old"
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize("make", [Path.mkdir, Path.touch])
def test_what_no_run_has_left_is_not_taken_for_a_leftover(tmp_path, make):
    own = tmp_path / ".out.partial"
    make(own)
    with pytest.raises(OutputError) as caught, new_folder(tmp_path / "out", marker=MARKER):
        pytest.fail("the block must not begin")
    assert str(caught.value) == (
        f"{own} stands where the output folder {tmp_path / 'out'} is made, and no run of dexnudge left it; expected nothing "
        "there; move it away, or choose another `out`"
    )
    assert os.listdir(tmp_path) == [".out.partial"]


def test_a_name_that_leaves_no_room_for_its_lock_is_refused(tmp_path):
    with new_folder(tmp_path / ("x" * 240), marker=MARKER) as folder:
        write(folder)
    with pytest.raises(OutputError, match="too long; expected at most 240 bytes"), new_folder("y" * 241, marker=MARKER):
        pytest.fail("the block must not begin")


def test_what_cannot_be_written_is_named_as_the_user_named_it(tmp_path):
    with (
        pytest.raises(OutputError) as caught,
        new_folder(tmp_path / "out", marker=MARKER) as folder,
        writing(f"the page {folder / 'view.html'}"),
    ):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert str(caught.value) == (
        f"cannot write the page {tmp_path / 'out' / 'view.html'}: No space left on device; expected a folder that exists, "
        "is writable and has free space"
    )


def test_a_folder_into_which_another_run_writes_is_not_replaced(tmp_path):
    out = tmp_path / "out"
    with new_folder(out, marker=MARKER) as folder:
        write(folder)
    with another_process(new(out / "execution")):
        enter_refused(new_folder(out, overwrite=True, marker=MARKER))


def test_an_owned_folder_that_stays_empty_goes_with_the_parents_made_for_it(tmp_path):
    with pytest.raises(InputError), owned_folder(tmp_path / "a" / "out"):
        raise InputError("bad")
    assert os.listdir(tmp_path) == []


def test_the_first_free_number_is_taken(tmp_path):
    assert free_folder(tmp_path / "out") == tmp_path / "out"
    (tmp_path / "out").mkdir()
    (tmp_path / "out-2").write_text("")
    assert free_folder(tmp_path / "out") == tmp_path / "out-3"


@pytest.mark.parametrize("kind", ["link", "link to nothing", "folder", "pipe"])
def test_what_stands_at_the_lock_s_place_is_named_and_left_alone(tmp_path, kind):
    precious, lock = tmp_path / "precious", tmp_path / ".out.dexnudge-lock"
    if kind == "link":
        precious.write_text("mine")
    make = {"folder": lock.mkdir, "pipe": lambda: os.mkfifo(lock)}.get(kind, lambda: lock.symlink_to(precious))
    make()
    with pytest.raises(OutputError, match=r"stands at .*dexnudge-lock"), new_folder(tmp_path / "out", marker="m"):
        pytest.fail("it was owned")
    assert (precious.read_text() if kind == "link" else precious.exists()) == ("mine" if kind == "link" else False)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("out", ["/", ""])
def test_a_path_without_a_name_is_no_output_folder(out):
    for own in (lambda: new_folder(out, marker="m"), lambda: owned_folder(out)):
        with pytest.raises(OutputError, match="expected the path of a folder to make"), own():
            pytest.fail("it was owned")
