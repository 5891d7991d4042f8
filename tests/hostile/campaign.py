"""Many hostile inputs, one after the other; a table of what came of them.

    PYTHONPATH=tests python -m hostile.campaign --count 10000 --seed 0 --out runs/fuzz

Goes on where it was stopped. An input that something is wrong with is kept in OUT/wrong, with its command.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import random
import shlex
import shutil
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path

from hostile.case import Draw, Hostile
from hostile.judge import Outcome, run, warm_up

MODULES = (
    "meshes",
    "hands",
    "arms",
    "scenes",
    "depth",
    "checkpoints",
    "datasets",
    "results",
    "plans",
    "options",
    "plugins",
    "grasps",
    "entries",
)
"""Each has DRAWS, by reader, and HANDMADE."""
REAL = 200  # one input in so many is run by a Python of its own
PAGE = Path(__file__).parents[2] / "docs/concepts/trust.md"
BEGIN, END = "<!-- campaign:begin -->", "<!-- campaign:end -->"
KINDS = {
    "arms": ("arm",),
    "datasets": ("dataset",),
    "depth images and point clouds": ("depth", "cloud npy", "cloud pcd", "cloud ply"),
    "episodes": ("episode",),
    "grasps of other tools": ("grasps",),
    "entries of a benchmark": ("entry",),
    "hands' descriptions": ("urdf", "mjcf", "xacro", "yaml"),
    "models": ("model",),
    "object meshes": ("obj", "stl", "ply", "off", "glb", "dae"),
    "options": ("options",),
    "packages": ("plugins",),
    "plans": ("plan",),
    "result folders": ("result",),
    "surroundings, scenes, poses": ("environment", "scene.json", "pose"),
    "training states": ("state",),
}
"""What the page calls them, and their readers."""
COLUMNS = ("number", "reader", "name", "verdict", "code", "seconds", "megabytes")


def hostile_inputs(
    seed: int, count: int, readers: Sequence[str] = (), names: Sequence[str] = MODULES
) -> Iterator[Hostile]:
    """Yield `count` inputs, the same for the same seed: one made by hand, one drawn, while there are some made by hand."""
    modules = [import_module(f"hostile.{name}") for name in names]
    handmade = [case for module in modules for case in module.HANDMADE if not readers or case.reader in readers]
    draws: dict[str, Draw] = {
        reader: draw for module in modules for reader, draw in module.DRAWS.items() if not readers or reader in readers
    }
    turns = itertools.cycle(draws.items())
    random.Random(seed).shuffle(handmade)
    drawn = (draw(random.Random(f"{seed} {reader} {number}")) for number, (reader, draw) in enumerate(turns))
    pairs = ([case, next(drawn)] for case in handmade)
    yield from itertools.islice(itertools.chain(itertools.chain.from_iterable(pairs), drawn), count)


def campaign(
    out: Path, *, seed: int, count: int, readers: Sequence[str] = (), real: int = REAL, names: Sequence[str] = MODULES
) -> list[dict[str, str]]:
    """Run the inputs that `out` has no row of yet; return all rows."""
    from dexnudge.jobs.progress import progress

    out.mkdir(parents=True, exist_ok=True)
    table = out / "outcomes.csv"
    done = _rows(table)
    warm_up()
    with table.open("a", newline="", encoding="utf-8") as file, progress() as bars:
        writer = csv.DictWriter(file, COLUMNS)
        if not done:
            writer.writeheader()
        bar = bars.add_task("hostile inputs", total=count, completed=len(done))
        for number, case in enumerate(hostile_inputs(seed, count, readers, names)):
            if number < len(done):
                continue
            with tempfile.TemporaryDirectory() as scratch:
                outcome = run(case, Path(scratch) / "case", real=number % real == real - 1)
            if not outcome.fine:
                _keep(out / "wrong", number, case, outcome)
            numbers = {
                "seconds": f"{outcome.seconds:.2f}",
                "megabytes": f"{outcome.megabytes:.0f}",
                "code": outcome.code,
            }
            row = {"number": number, "reader": case.reader, "name": ascii(case.name)[1:-1][:120]}
            writer.writerow({**row, "verdict": outcome.verdict, **numbers})
            file.flush()
            bars.advance(bar)
    rows = _rows(table)
    (out / "summary.json").write_text(json.dumps(summary(rows), indent=2) + "\n", encoding="utf-8")
    return rows


def summary(rows: Sequence[dict[str, str]]) -> dict[str, dict[str, int]]:
    """Return how often each verdict was given, by reader."""
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for row in rows:
        counts[row["reader"]].update(["tried", row["verdict"]])
    return {reader: dict(found) for reader, found in sorted(counts.items())}


def write_page(rows: Sequence[dict[str, str]], *, seed: int) -> None:
    """Put what came of the inputs into the page, between its marks."""
    from dexnudge.jobs.provenance import machine, versions

    lines = ["| input | tried | refused | accepted | wrong |", "|---|---|---|---|---|"]
    for kind, readers in {**KINDS, "all": tuple(itertools.chain.from_iterable(KINDS.values()))}.items():
        verdicts = Counter(row["verdict"] for row in rows if row["reader"] in readers)
        told = verdicts["refused"], verdicts["accepted"]
        lines.append(f"| {kind} | {verdicts.total()} | {told[0]} | {told[1]} | {verdicts.total() - sum(told)} |")
    made = "; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items())
    text = "\n".join([f"The first {len(rows):,} inputs of seed {seed}.", "", *lines, "", f"Made with {made}."])
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{text}\n{END}{rest.partition(END)[2]}", encoding="utf-8")


def _rows(table: Path) -> list[dict[str, str]]:
    if not table.is_file():
        return []
    with table.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _keep(wrong: Path, number: int, case: Hostile, outcome: Outcome) -> None:
    folder = wrong / f"{case.reader}-{number}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    case.write(folder)
    said = f"{case.name!a}\n{outcome.verdict}\ndexnudge {shlex.join(case.arguments)}\n{outcome.said}"
    (folder / "WRONG.txt").write_text(said, encoding="utf-8", errors="backslashreplace")


def main() -> int:
    """Run a campaign, and print its table."""
    parser = argparse.ArgumentParser(prog="hostile.campaign", description="many hostile inputs, judged")
    parser.add_argument("--count", type=int, default=10_000, help="inputs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--readers", nargs="*", default=[], help="some readers only, such as obj urdf")
    parser.add_argument("--real", type=int, default=REAL, help="one input in so many in a Python of its own")
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz"), help="folder of outcomes.csv and summary.json")
    parser.add_argument("--modules", nargs="*", default=MODULES, choices=MODULES, dest="names", help="some of them")
    parser.add_argument("--page", action="store_true", help="only write what OUT holds so far into the page on trust")
    options = vars(parser.parse_args())
    if options.pop("page"):
        write_page(_rows(options["out"] / "outcomes.csv"), seed=options["seed"])
        return 0
    rows = campaign(**options)
    for reader, counts in summary(rows).items():
        print(f"{reader:<14}" + ", ".join(f"{number} {verdict}" for verdict, number in counts.items()))
    return int(any(row["verdict"] not in ("refused", "accepted") for row in rows))


if __name__ == "__main__":
    raise SystemExit(main())
