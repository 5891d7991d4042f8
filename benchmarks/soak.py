"""Is memory flat over many scenes in one process, and over an hour of random clicks in the studio?

    python benchmarks/soak.py scenes --num 2000
    python benchmarks/soak.py studio --minutes 60 --result DIR

Each writes its row of the table in docs/concepts/trust.md, `page` all that docs/data/soak.json holds.
"""

import atexit
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

import dexnudge as dn
from dexnudge.jobs.provenance import machine, versions

ROOT = Path(__file__).parents[1]
DATA, PAGE = ROOT / "docs/data/soak.json", ROOT / "docs/concepts/trust.md"
BEGIN, END = "<!-- soak:begin -->", "<!-- soak:end -->"
EVERY = 25  # scenes between two rows; in the studio it is a minute
UNIT = {"scenes": ("scenes", 1000, "1,000 scenes"), "studio": ("minutes", 60, "hour")}
COUNTED = ("memory [MB]", "open files", "threads", "temporary files")
DEEDS = (  # what is done in the studio: how, in which tab, to what, and the largest number that is typed
    *(("press", *what) for what in (("Draws", "next"), ("Play", "Play"), ("View", "Look from the best side"))),
    *(("press", "Sample", button) for button in ("Sample", "Build", "Save")),
    *(("toggle", "Draws", box) for box in ("all of them together", "clearance")),
    *(("fill", *what) for what in (("Draws", "draw", 8), ("Play", "speed", 4), ("View", "opacity", 1))),
    *(("fill", "Sample", *what) for what in (("draws", 16), ("scene's seed", 99))),
)


def counted(process: int, folder: Path) -> list[float]:
    """Return what a process holds, see `COUNTED`; `folder` is where its temporary files lie."""
    proc = Path(f"/proc/{process}")
    pages = int((proc / "statm").read_text().split()[1])
    held = [len([*(proc / each).iterdir()]) for each in ("fd", "task")]
    return [pages * os.sysconf("SC_PAGE_SIZE") / 1e6, *held, sum(path.is_file() for path in folder.rglob("*"))]


def soak_scenes(num: int, folder: Path) -> tuple[list[list[float]], Counter[str]]:
    """Sample two draws in each of so many different scenes; return a row after every 25th, and what came of them."""
    sampler, made, rows = dn.Sampler(dn.load_hand("shadow_lite")), Counter[str](), []
    problems = [*product(dn.builtin_names("train"), dn.scene_families())]
    for number in range(num):
        name, family = problems[number % len(problems)]
        try:
            scene = dn.build_scene(family, name, seed=number // len(problems))
            made["verified draws"] += sampler.sample(scene, num=2, seed=number).num_verified
            made["sampled"] += 1
        except dn.DexnudgeError:
            made["refused"] += 1
        if number % EVERY == EVERY - 1:
            rows.append([number + 1, *counted(os.getpid(), folder)])
            print(*(f"{value:.0f}" for value in rows[-1]), flush=True)
    return rows, made


def soak_studio(minutes: float, result: Path | None, folder: Path) -> tuple[list[list[float]], Counter[str]]:
    """Click at random in the studio's page for so long; return a row a minute, and how often each thing was done."""
    import browser
    from playwright.sync_api import Error

    (left := folder / "left").mkdir()
    command = [sys.executable, "-m", "dexnudge", "view", *([result] if result else []), "--port", "0"]
    command += ["--out", folder / "saved"]
    studio = subprocess.Popen(command, env={**os.environ, "TMPDIR": str(left)}, stdout=subprocess.PIPE, text=True)
    atexit.register(studio.kill)
    url = next(line.split()[1] for line in studio.stdout or () if line.startswith("studio: "))
    chance, done, rows, start = random.Random(0), Counter[str](), [], time.monotonic()  # noqa: S311 - clicks
    with browser.opened_page(url, size=(500, 400)) as page:
        page.on("pageerror", lambda error: done.update([f"error: {error}"]))
        browser.first_frame(page)
        browser.tab(page, "Sample")
        page.get_by_text("Another scene: object, family, seed").click()
        page.set_default_timeout(20_000)
        while (passed := (time.monotonic() - start) / 60) < minutes:
            if passed > len(rows):
                rows.append([passed, *counted(studio.pid, left)])
                print(*(f"{value:.0f}" for value in rows[-1]), dict(done), flush=True)
            act, where, what, *most = chance.choice(DEEDS)
            with suppress(Error):  # a button that is off
                browser.tab(page, where)
                getattr(browser, act)(page, what, *(chance.randint(1, each) for each in most))
                done[what] += 1
        rows.append([passed, *counted(studio.pid, left)])
    studio.terminate()
    done["exit code"] = studio.wait(120)  # a busy machine
    return rows, done


def write_page(content: dict[str, dict]) -> None:
    """Put the table into the page, between its marks; the slope is that of the second half."""
    lines = [["run", "from … to", *COUNTED, "memory in the second half"], ["---", "---", *["---:"] * 5]]
    for part, found in content.items():
        (unit, per, words), rows = UNIT[part], np.array(found["rows"])
        slope = np.polyfit(*rows[len(rows) // 2 :, :2].T, 1)[0] * per
        ends = [f"{first:.0f} … {last:.0f}" for first, last in zip(rows[0], rows[-1], strict=True)]
        lines.append([part, f"{ends[0]} {unit}", *ends[1:], f"{slope:+.0f} MB in {words}"])
    text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    made = "; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items())
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{text}\n\nMade with {made}.\n{END}{rest.partition(END)[2]}", encoding="utf-8")


Part = Annotated[Literal["scenes", "studio", "page"], tyro.conf.Positional]


def main(part: Part, num: int = 2000, minutes: float = 60.0, result: Path | None = None) -> None:
    """Run one part, keep its rows and write the page; result: folder that `sample` and `execute` wrote, for the studio."""
    if part != "page":
        with tempfile.TemporaryDirectory() as name:
            tempfile.tempdir, folder = name, Path(name)
            rows, done = soak_scenes(num, folder) if part == "scenes" else soak_studio(minutes, result, folder)
            tempfile.tempdir = None
        content = json.loads(DATA.read_text(encoding="utf-8")) if DATA.is_file() else {}
        content[part] = {"rows": np.round(rows, 2).tolist(), "done": dict(done)}
        DATA.write_text(json.dumps(dict(sorted(content.items())), indent=1) + "\n", encoding="utf-8")
    write_page(json.loads(DATA.read_text(encoding="utf-8")))


if __name__ == "__main__":
    tyro.cli(main)
