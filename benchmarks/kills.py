"""Long jobs that are killed, over and over, until they are done: what is lost, doubled, or other than in a run undisturbed.

Half of the kills come at a random moment of the run, half just before a random change of a file or folder in its output.
A kill takes the whole job, workers too. Then Ctrl-C, a full disk and a second job on the same folder.
"""

import hashlib
import json
import math
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import tyro
from safetensors import safe_open

from dexnudge.cli.arguments import stdout, table
from dexnudge.cli.main import COMMANDS, command_class, run
from dexnudge.experiments.learning.learn import write_plan
from dexnudge.experiments.learning.plan import LearningPlan, LearningRates
from dexnudge.hands.export import export_hand
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.jobs.processes import limit_threads
from dexnudge.jobs.provenance import machine, versions

# Every process of a job imports this: it ends the whole job at change number KILL_AT of a file or folder below KILL_BELOW.
SITE = """
import os, signal, sys
left = int(os.environ["KILL_AT"])
def hook(event, arguments):
    global left
    if event == "open":
        changes = isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
    else:
        changes = event in ("os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.truncate", "os.link")
    if changes and os.environ["KILL_BELOW"] in repr(arguments):
        left -= 1
        if not left:
            os.killpg(0, signal.SIGKILL)
sys.addaudithook(hook)
"""
MOST_CHANGES = 40  # of one process that a kill may wait for; smaller jobs end before it
NEEDED = (
    "torch.utils.tensorboard",
    "dexnudge.diffusion.training",
    "dexnudge.execution.folder",
    "dexnudge.experiments.execution_trial",
    "dexnudge.experiments.learning.learn",
    "dexnudge.trajectories.plan_folder",
    "dexnudge.trajectories.planner",
)
IMPORT = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); import torch"
PATIENCE = 600.0  # [s] for any start
WALL_CLOCK = (
    *("seconds", "minutes", "max_minutes", "train/steps_per_s", "seconds_total", "peak_memory_mb", "time"),
    *("verified_per_second", "seconds_per_verified", "At equal time on the wall clock"),
)
NOT_COMPARED = ("log.jsonl", "clock.json", "tensorboard")  # how the run went, not its result
PAGES = (".md", ".html", ".csv", ".svg")  # have wall-clock times in them: they only have to be there


@dataclass(frozen=True)
class Job:
    """A command, where it writes, and what has to stand there before it starts.

    arguments: `{out}` stands for its folder. prepare: makes what it needs in that folder. replaces: whether it replaces its
    output in one step; else it goes on with what is there.
    """

    name: str
    arguments: list[str]
    prepare: Callable[[Path], object] = lambda _: None
    replaces: bool = False

    def start(self, out: Path, *, size: int = -1, kill_at: int = 0) -> "Running":
        """Start the command in a session of its own, forked from this process, which has its imports.

        size: largest file that it can write [bytes]. kill_at: the change of a file or folder at which it is killed.
        """
        said = Path(f"{out}.txt")
        with said.open("wb") as file:
            child = os.fork()
            if child:
                return Running(child, said)
            os.setsid()
            for stream in (1, 2):
                os.dup2(file.fileno(), stream)
        if kill_at:
            site = out.with_name("site")
            site.mkdir(exist_ok=True)
            (site / "sitecustomize.py").write_text(SITE)  # for the Python of each worker
            os.environ |= {"KILL_AT": str(kill_at), "KILL_BELOW": str(out)}
            os.environ["PYTHONPATH"] = os.pathsep.join([str(site), *sys.path])
            exec(SITE, {})  # noqa: S102 - our own
        if size >= 0:
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        signal.signal(
            signal.SIGINT, signal.default_int_handler
        )  # shells let what they start in the background ignore it
        sys.argv = ["dexnudge", *(each.format(out=out) for each in self.arguments)]
        code: Any = 1
        try:
            run()
        except SystemExit as end:
            code = end.code
        except BaseException:  # noqa: BLE001 - Python would print it
            with suppress(OSError):  # where even that cannot be written
                traceback.print_exc()
        finally:  # the folders of this process are not the child's to remove
            with suppress(OSError):
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(code)

    def finish(self, out: Path, *, size: int = -1) -> tuple[int, str]:
        """Run the command to its end; return exit code and what it said."""
        running = self.start(out, size=size)
        return running.ended(PATIENCE), running.said.read_text()


@dataclass(frozen=True)
class Running:
    """A process that leads a session of its own, and the file of what it says."""

    process: int
    said: Path

    def ended(self, seconds: float, how: signal.Signals = signal.SIGKILL) -> int:
        """Wait for its end, and send a signal to its whole session after so many seconds; return its exit code."""
        deadline = time.monotonic() + seconds
        while True:
            done, status = os.waitpid(self.process, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
            if time.monotonic() > deadline:
                os.killpg(self.process, how)
                deadline = math.inf
            time.sleep(0.02)


@dataclass
class Outcome:
    """What came of a job's kills: numbers of kills, of runs that were killed until done, and of items that differ."""

    kills: int = 0
    runs: int = 0
    lost: int = 0
    doubled: int = 0
    differing: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)


def items(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield what a job has written, as name and digest: a line of a table is an item, every other file is one."""
    for path in sorted(folder.rglob("*")):
        name, places = path.relative_to(folder).as_posix(), path.relative_to(folder).parts
        if not path.is_file() or any(place in NOT_COMPARED or place.startswith(".") for place in places):
            continue
        if path.suffix in (".jsonl", ".json"):
            text = path.read_text().replace(str(folder), "")  # an evaluation of a hand names the hand's folder
            parts = text.splitlines() if path.suffix == ".jsonl" else [text]
            yield from ((name, digest(without_times(json.loads(part)))) for part in parts)
        elif path.suffix in PAGES:
            yield name, ""
        elif path.suffix == ".safetensors":
            yield name, digest(tensors(path))
        else:
            yield name, hashlib.sha256(path.read_bytes()).hexdigest()


def without_times(content: Any) -> Any:
    """Return JSON without what is measured by a clock."""
    if isinstance(content, dict):
        return {key: without_times(value) for key, value in content.items() if key not in WALL_CLOCK}
    return [without_times(each) for each in content] if isinstance(content, list) else content


def tensors(path: Path) -> Any:
    """Return the header of a file of tensors, without times, and the digest of each."""
    with safe_open(path, framework="pt") as file:
        header = {key: without_times(json.loads(value)) for key, value in (file.metadata() or {}).items()}
        header.get("training", {}).pop("sha256", None)  # of a state; its times are part of it
        arrays = {name: file.get_tensor(name).contiguous().numpy().tobytes() for name in file.keys()}  # noqa: SIM118
    return header, {name: hashlib.sha256(array).hexdigest() for name, array in arrays.items()}


def digest(content: Any) -> str:
    """Return a short name of JSON content."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def killed_until_done(job: Job, work: Path, rng: random.Random, seconds: float, kills: int, outcome: Outcome) -> None:
    """Start a job again and again, killed at most `kills` times, and compare what it leaves with work/reference."""
    out = work / "killed"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    job.prepare(out)
    wanted = dict_of(work / "reference")
    if job.replaces:
        shutil.copytree(work / "reference", out, dirs_exist_ok=True)
    for _ in range(kills):
        at_change = rng.random() < 0.5
        running = job.start(out, kill_at=rng.randint(1, MOST_CHANGES) if at_change else 0)
        code = running.ended(PATIENCE if at_change else rng.uniform(0.0, seconds))
        if code != -signal.SIGKILL:
            outcome.failures += [] if code == 0 else [running.said.read_text()]
            break
        outcome.kills += 1
        if job.replaces and dict_of(out) != wanted:
            outcome.failures.append("neither the old folder nor a complete one")
    code, said = job.finish(out)
    outcome.failures += [] if code == 0 else [said]
    found, outcome.runs = dict_of(out), outcome.runs + 1
    if leftovers := sorted(str(path.relative_to(out)) for path in out.rglob(".*")):
        outcome.failures.append(f"left behind: {', '.join(leftovers)}")
    outcome.lost += (Counter(name for name, _ in wanted) - Counter(name for name, _ in found)).total()
    outcome.doubled += (Counter(name for name, _ in found) - Counter(name for name, _ in wanted)).total()
    outcome.differing += sorted({name for name, _ in (wanted - found) + (found - wanted)})


def dict_of(folder: Path) -> Counter[tuple[str, str]]:
    """Return every item with its number."""
    return Counter(items(folder))


def interrupted(job: Job, work: Path, rng: random.Random, seconds: float) -> tuple[float, int, str]:
    """Interrupt a new run at a random moment; return seconds until it ended, exit code, and its last line."""
    out = work / "interrupted"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    job.prepare(out)
    running = job.start(out)
    moment, began = rng.uniform(0.0, 0.9) * seconds, time.monotonic()
    code = running.ended(moment, signal.SIGINT)
    return time.monotonic() - began - moment, code, last_line(running.said.read_text())


def interrupted_import(rng: random.Random) -> float:
    """Return the seconds that Python itself takes to end when it is interrupted within an import: what no job undercuts."""
    with subprocess.Popen([sys.executable, "-c", IMPORT], stderr=subprocess.DEVNULL) as process:
        time.sleep(rng.uniform(0.3, 1.5))
        began = time.monotonic()
        process.send_signal(signal.SIGINT)
        process.wait()
    return time.monotonic() - began


def last_line(said: str) -> str:
    """Return the message of a command, or the last line that it printed."""
    lines = said.strip().splitlines() or [""]
    return next((line for line in lines if line.startswith("dexnudge: ")), lines[-1])


def on_a_full_disk(job: Job, work: Path, size: int) -> tuple[int, str]:
    """Run a job that cannot write a file of more than `size` bytes, then go on without; return code and last line.

    RuntimeError where it shows a traceback, or does not end in the reference afterwards.
    """
    out = work / "full"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    job.prepare(out)
    if job.replaces:
        shutil.copytree(work / "reference", out, dirs_exist_ok=True)
    code, said = job.finish(out, size=size)
    if "Traceback" in said or (job.replaces and dict_of(out) != dict_of(work / "reference")):
        raise RuntimeError(f"{job.name}, files of at most {size} bytes: {said[-2000:]}")
    again, more = job.finish(out)
    found, wanted = dict_of(out), dict_of(work / "reference")
    if again or found != wanted:
        differing = sorted({name for name, _ in (wanted - found) + (found - wanted)})
        raise RuntimeError(f"{job.name}, after a full disk: {again} {differing} {more[-2000:]}")
    return code, last_line(said)


def warm_up() -> None:
    """Import what the jobs need; no thread may be left that a fork would lose."""
    limit_threads()
    os.environ["OMP_NUM_THREADS"] = "1"
    for name in COMMANDS:
        command_class(name)
    for module in NEEDED:
        import_module(module)


def jobs(work: Path) -> list[Job]:
    """Return small jobs of each kind; the folder holds what they need."""
    hand = load_hand("shadow_lite")
    data, samples = work / "data", work / "samples"

    generate = "dataset generate --objects builtin:train:2 --non-prehensile 8 --grasps 0 --workers 1"

    def with_data(_: Path) -> None:
        if not data.is_dir():
            Job("", f"{generate} --out {data}".split()).finish(data)

    def with_samples(out: Path) -> None:
        if not samples.is_dir():
            Job("", f"sample phone --scene table --num 8 --out {samples}".split()).finish(samples)
        shutil.copytree(samples, out, dirs_exist_ok=True)

    drawn = "--scenes table --method random_start_projection --num 1"
    evaluate = f"evaluate --objects builtin:test --max-objects 2 {drawn} --workers 1 --out {{out}}"
    training = "--steps 40 --groups 2 --rows-per-group 4 --num-points 32 --width 16 --depth 1 --num-heads 2"
    often = "--validate-every 10 --checkpoint-every 8 --log-every 3 --num-threads 1"
    return [
        Job("train", f"train --data {data} --out {{out}} {training} {often}".split(), prepare=with_data),
        Job("evaluate", evaluate.split()),
        Job("evaluate --execute", f"{evaluate} --execute".split()),
        Job("hand --learn", ["hand", "{out}", "--learn"], prepare=lambda out: with_plan(out, hand)),
        Job("execute", ["execute", "{out}", "--films", "0", "--overwrite"], prepare=with_samples, replaces=True),
        Job("plan", ["plan", "{out}", "--films", "0", "--overwrite"], prepare=with_samples, replaces=True),
        Job("dataset generate", f"{generate} --out {{out}}".split()),
    ]


def with_plan(folder: Path, hand: Hand) -> None:
    """Prepare a hand with a plan that is as small as can be, and that no clock cuts."""
    rates = LearningRates(start=0.0, attempt=0.01, kept=0.3, step=5.0, trial=5.0)  # saved after every sixth step
    numbers = {"objects": 2, "attempts": 8, "grasps": 0, "steps": 4, "trial_objects": 1, "draws": 1}
    seconds = {"measuring": 1.0, "data": 60.0, "training": 3600.0, "evaluation": 60.0}
    export_hand(hand, folder)
    write_plan(
        folder,
        hand,
        LearningPlan(minutes=600.0, workers=1, seed=3, scenes=("table",), rates=rates, **numbers, **seconds),
    )


@dataclass(frozen=True)
class Benchmark:
    """Kill, interrupt and starve each job."""

    kills: int = 15
    """Kills of each job."""
    kills_a_run: int = 8
    """Then it may end, and a new run begins."""
    interrupts: int = 3
    """Of each job."""
    sizes: tuple[int, ...] = (0, 4096, 65536)
    """Largest file that a full disk takes [bytes]."""
    only: tuple[str, ...] = ()
    """Names of jobs; all unless given."""
    seed: int = 0
    """Seed of the moments."""

    def run(self) -> int:
        """Print machine, versions and a line for each job; return how many failed."""
        console, rng = stdout(), random.Random(self.seed)  # noqa: S311 - moments, no secrets
        console.print("; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items()), soft_wrap=True)
        shown = table("job", "seconds", "kills", "runs", "lost", "doubled", "bytes", "Ctrl-C s", "full disk")
        floor = max((interrupted_import(rng) for _ in range(self.interrupts)), default=0.0)
        console.print(f"Ctrl-C during `import torch`, the slowest of {self.interrupts}: {floor:.1f} s", soft_wrap=True)
        console.print(f"seed {self.seed}; load {os.getloadavg()[0]:.0f}", soft_wrap=True)
        failed = 0
        warm_up()
        with tempfile.TemporaryDirectory() as folder:
            known = {job.name: job for job in jobs(Path(folder))}
            for name in self.only:
                if name not in known:
                    raise SystemExit(f"no job {name!r}; expected some of {', '.join(map(repr, known))}")
            for job in [known[name] for name in self.only or known]:
                work = Path(folder, job.name.replace(" ", "-"))
                seconds, outcome = self._killed(job, work, rng)
                slowest, disk = 0.0, []
                for _ in range(self.interrupts):
                    took, code, said = interrupted(job, work, rng, seconds)
                    slowest = max(slowest, took)
                    if code not in (0, 130) or (code and "`dexnudge " not in said):
                        outcome.failures.append(f"Ctrl-C: {code} {said}")
                for size in self.sizes:
                    code, said = on_a_full_disk(job, work, size)
                    disk.append(code)
                    console.print(f"{job.name}, files of at most {size} bytes: {code} {said}", soft_wrap=True)
                same = "equal" if not outcome.differing else ", ".join(outcome.differing)
                numbers = (outcome.kills, outcome.runs, outcome.lost, outcome.doubled)
                row = (
                    job.name,
                    f"{seconds:.0f}",
                    *map(str, numbers),
                    same,
                    f"{slowest:.1f}",
                    ", ".join(map(str, disk)),
                )
                shown.add_row(*row)
                console.print(" | ".join(row), soft_wrap=True)  # the table comes at the end
                failed += bool(outcome.failures or outcome.differing)
                for failure in outcome.failures:
                    console.print(f"{job.name}: {failure[-2000:]}", soft_wrap=True)
        console.print(shown)
        return failed

    def _killed(self, job: Job, work: Path, rng: random.Random) -> tuple[float, Outcome]:
        reference, outcome = work / "reference", Outcome()
        reference.mkdir(parents=True)
        job.prepare(reference)
        began = time.monotonic()
        code, said = job.finish(reference)
        seconds = time.monotonic() - began
        outcome.failures += [] if code == 0 else [f"undisturbed: {said}"]
        while outcome.kills < self.kills and not outcome.failures:
            most = min(self.kills_a_run, self.kills - outcome.kills)
            killed_until_done(job, work, rng, seconds, most, outcome)
        return seconds, outcome


if __name__ == "__main__":
    sys.exit(tyro.cli(Benchmark).run())
