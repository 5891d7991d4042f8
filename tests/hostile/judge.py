"""One input, run as a user would run it but for the start of Python, and judged."""

from __future__ import annotations

import gc
import hashlib
import os
import pkgutil
import re
import resource
import shlex
import signal
import subprocess
import sys
import time
import traceback
from contextlib import redirect_stderr, suppress
from dataclasses import dataclass
from importlib import import_module
from io import StringIO
from pathlib import Path

from hostile.case import MARKUP, MISSING_HAND, Hostile

SECONDS = 30  # of computing for one input
WAITED = 120  # [s] of wall time, on a machine that is busy; a command that waits for a pipe computes nothing
MEMORY = 4 * 2**30  # bytes of address space
LONGEST_MESSAGE = 20_000  # characters
HASHED = 10_000_000  # bytes; larger files are compared by their size
REFUSED, NOTHING = 2, 3  # exit codes
UNPRINTABLE = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


@dataclass(frozen=True)
class Outcome:
    """What came of an input: `verdict` is refused or accepted, or else what is wrong."""

    verdict: str
    code: int
    seconds: float
    megabytes: float
    said: str

    @property
    def fine(self) -> bool:
        """Whether nothing is wrong."""
        return self.verdict in ("refused", "accepted")


def warm_up() -> None:
    """Import what commands need, so that a forked child need not; no thread may be left that a fork would lose."""
    os.environ.update(OMP_NUM_THREADS="1", DEXNUDGE_CACHE="off")
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"  # its own keeps addresses, of which a child may have few
    import dexnudge as dn

    for module in pkgutil.walk_packages(dn.__path__, "dexnudge."):
        if not module.name.endswith("__main__"):
            import_module(module.name)
    import collada  # noqa: F401 - a reader that trimesh imports when it is needed
    import mujoco  # noqa: F401 - of the simulations
    import torch._dynamo
    from tyro import _unsafe_cache

    from dexnudge.cli.main import COMMANDS, command_class, parse

    torch.set_num_threads(1)  # threads do not survive a fork
    _unsafe_cache.clear_cache = lambda: None  # it empties what was read of docstrings at the end of each command
    for name in COMMANDS:
        with suppress(SystemExit), redirect_stderr(StringIO()):
            parse(name, command_class(name), ["--help-me"])
    dn.load_arm("panda")
    dn.build_scene("table", "phone").findings(dn.load_hand("shadow_lite"))
    gc.freeze()  # a collection in a child would copy all pages


def run(case: Hostile, folder: Path, *, real: bool = False) -> Outcome:
    """Write the files into `folder`, run the command there in a child of this process (real: in a Python of its own, under
    `ulimit -v`), and judge."""
    work = folder / "work"
    work.mkdir(parents=True)
    case.write(work)
    before, started = _files(folder), time.monotonic()
    with (folder.parent / "out.txt").open("wb") as out, (folder.parent / "err.txt").open("wb") as err:
        child = (
            _started(case, work, out.fileno(), err.fileno())
            if real
            else _forked(case, work, out.fileno(), err.fileno())
        )
    code, usage = _ended(child)
    seconds = time.monotonic() - started
    said_out, said_err = ((folder.parent / name).read_text("utf-8", "replace") for name in ("out.txt", "err.txt"))
    verdict = _verdict(case, code, said_out, said_err) or _written(folder, before) or _pages(work)
    read = code in (0, NOTHING) or (code == REFUSED and MISSING_HAND in said_err)
    kind = "accepted" if read else "refused"
    if not verdict and case.expected not in ("either", kind):
        verdict = f"wrongly {kind}"
    if not verdict and case.says and case.says not in said_err:
        verdict = "another message"
    return Outcome(verdict or kind, code, seconds, usage.ru_maxrss / 1024, said_err[-2000:])


def _limited() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _forked(case: Hostile, work: Path, out: int, err: int) -> int:
    child = os.fork()
    if child:
        return child
    code: object = 1
    try:
        os.setsid()
        os.chdir(work)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(out, 1)
        os.dup2(err, 2)
        _limited()
        from dexnudge.cli.main import run

        sys.argv = ["dexnudge", *case.arguments]
        run()
    except SystemExit as exit_:
        code = exit_.code or 0
    except BaseException:  # noqa: BLE001 - Python would print it
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code if isinstance(code, int) else 1)


def _started(case: Hostile, work: Path, out: int, err: int) -> int:
    limits = f"ulimit -c 0 -v {MEMORY // 1024} -t {SECONDS}; exec "
    command = limits + shlex.join([sys.executable, "-m", "dexnudge", *case.arguments])
    return subprocess.Popen(  # waited for by `_ended`
        ["/bin/bash", "-c", command], cwd=work, stdin=subprocess.DEVNULL, stdout=out, stderr=err, start_new_session=True
    ).pid


def _ended(child: int) -> tuple[int, resource.struct_rusage]:
    """Wait for a child, at most so long; return its exit code (negative: its signal) and what it used."""
    deadline, pause = time.monotonic() + WAITED, 0.001
    while True:
        done, status, usage = os.wait4(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status), usage
        if time.monotonic() > deadline:
            os.killpg(child, signal.SIGKILL)
            return -signal.SIGKILL, os.wait4(child, 0)[2]
        time.sleep(pause)
        pause = min(2 * pause, 0.05)


def _verdict(case: Hostile, code: int, out: str, err: str) -> str:
    """Return what is wrong with how a command ended, in a word or two; nothing where all is well."""
    raised = case.reader == "plugins" and "no memory" in case.name  # a package's own, of which there is enough
    told = "dexnudge: ran out of memory" in err and case.reader != "options"  # which may ask for more than there is
    if "bad_alloc" in err or ((told or ("MemoryError" in err and "Traceback" in err)) and not raised):
        return "memory"
    if "Traceback" in err or code == 1:
        return "traceback"
    if code in (-signal.SIGKILL, -signal.SIGXCPU):
        return "hang"
    if code < 0:
        return f"died of {signal.Signals(-code).name}"
    if code not in (0, REFUSED, NOTHING):
        return f"exit code {code}"
    if UNPRINTABLE.search(err) or UNPRINTABLE.search(out):
        return "unescaped"
    lines = [line for line in err.splitlines() if line.startswith("dexnudge: ")]
    usage = err.startswith("╭")  # tyro's, in a box
    if code == REFUSED and not usage and (len(lines) != 1 or not err.startswith("dexnudge: ")):
        return "not one message"
    if code != REFUSED and err.strip():
        return "noise on stderr"
    return "long message" if len(err) > LONGEST_MESSAGE else ""


def _files(folder: Path) -> dict[str, str]:
    """Return a digest of every file below the folder but for those of `work/out`."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name == "work/out" or name.startswith("work/out/"):
            continue
        if path.is_symlink():
            found[name] = f"link to {path.readlink()}"
        elif path.is_file() and path.stat().st_size > HASHED:
            found[name] = f"{path.stat().st_size} bytes"
        elif path.is_file():
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        else:
            found[name] = "folder"
    return found


def _written(folder: Path, before: dict[str, str]) -> str:
    after = _files(folder)
    changed = sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name))
    return f"changed {changed[0][:60]}" if changed else ""


def _pages(work: Path) -> str:
    pages = (work / "out").rglob("*.html") if (work / "out").is_dir() else ()
    return "unescaped page" if any(MARKUP in page.read_text("utf-8", "replace") for page in pages) else ""
