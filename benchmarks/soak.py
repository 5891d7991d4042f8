"""Is memory flat over many scenes in one process, and over an hour of random clicks in the studio?

    python benchmarks/soak.py scenes --num 2000
    python benchmarks/soak.py studio --minutes 60

Both write their row of the table in docs/concepts/trust.md, `page` both rows from docs/data/soak.json. The slope is that
of the second half.
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
EVERY = {"scenes": 25, "studio": 60.0}  # scenes, seconds between two rows
UNIT = {"scenes": ("scenes", 1000, "1,000 scenes"), "studio": ("minutes", 60, "hour")}
COUNTED = ("memory [MB]", "open files", "threads", "temporary files")
Part = Literal["scenes", "studio", "page"]


def counted(process: int, folder: Path) -> list[float]:
    """Return what a process holds, see `COUNTED`; `folder` is where its temporary files lie."""
    proc = Path(f"/proc/{process}")
    pages = int((proc / "statm").read_text().split()[1])
    files = sum(not path.is_dir() for path in folder.rglob("*"))
    return [
        pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
        *(len([*(proc / each).iterdir()]) for each in ("fd", "task")),
        files,
    ]


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
        if number % EVERY["scenes"] == EVERY["scenes"] - 1:
            rows.append([number + 1, *counted(os.getpid(), folder)])
            print(*(f"{value:.0f}" for value in rows[-1]), flush=True)
    return rows, made


def soak_studio(minutes: float, folder: Path) -> tuple[list[list[float]], Counter[str]]:
    """Click at random in the studio's page for so long; return a row a minute, and how often each thing was done."""
    from browser import fill, first_frame, opened_page, press, tab, toggle
    from playwright.sync_api import Error

    dexnudge, work, left = [sys.executable, "-m", "dexnudge"], folder / "work", folder / "left"
    left.mkdir()
    subprocess.run(
        [*dexnudge, "sample", "phone", "--scene", "table", "--num", "8", "--out", work / "drawn"], check=True
    )
    subprocess.run([*dexnudge, "execute", work / "drawn", "--films", "0"], check=False)
    command = [*dexnudge, "view", work / "drawn", "--port", "0", "--out", work / "saved"]
    studio = subprocess.Popen(command, env={**os.environ, "TMPDIR": str(left)}, stdout=subprocess.PIPE, text=True)
    atexit.register(studio.kill)
    url = next(line.split()[1] for line in studio.stdout or () if line.startswith("studio: "))
    chance, done, rows, start = random.Random(0), Counter[str](), [], time.monotonic()  # noqa: S311 - clicks
    with opened_page(url) as page:
        page.on("pageerror", lambda error: done.update([f"error: {error}"]))
        first_frame(page)
        tab(page, "Sample")
        page.get_by_text("Another scene: object, family, seed").click()
        page.set_default_timeout(10_000)
        deeds = {
            "next draw": lambda: (tab(page, "Draws"), press(page, "next")),
            "draw": lambda: (tab(page, "Draws"), fill(page, "draw", chance.randint(1, 8))),
            "together": lambda: (tab(page, "Draws"), toggle(page, "all of them together")),
            "clearance": lambda: (tab(page, "Draws"), toggle(page, "clearance")),
            "play": lambda: (tab(page, "Play"), press(page, chance.choice(["Play", "Pause"]))),
            "time": lambda: (tab(page, "Play"), fill(page, "time [s]", round(chance.random(), 2))),
            "fade": lambda: (tab(page, "View"), fill(page, "opacity", round(chance.uniform(0.1, 1), 1))),
            "look": lambda: (tab(page, "View"), press(page, "Look from the best side")),
            "sample": lambda: (tab(page, "Sample"), fill(page, "draws", chance.randint(1, 16)), press(page, "Sample")),
            "build": lambda: (
                tab(page, "Sample"),
                fill(page, "scene's seed", chance.randint(0, 99)),
                press(page, "Build"),
            ),
            "save": lambda: (tab(page, "Sample"), press(page, "Save")),
        }
        while (passed := time.monotonic() - start) < 60 * minutes:
            if passed > EVERY["studio"] * len(rows):
                rows.append([passed / 60, *counted(studio.pid, left)])
                print(*(f"{value:.0f}" for value in rows[-1]), dict(done), flush=True)
            name = chance.choice([*deeds])
            with suppress(Error):  # a button that is off, or behind another tab
                deeds[name]()
                done[name] += 1
            page.wait_for_timeout(300)
        rows.append([(time.monotonic() - start) / 60, *counted(studio.pid, left)])
    studio.terminate()
    done["exit code"] = studio.wait(30)
    return rows, done


def write_page(content: dict[str, dict]) -> None:
    """Put the table into the page, between its marks."""
    header = ["run", "from … to", *COUNTED, "memory in the second half"]
    lines = [header, ["---"] * 2 + ["---:"] * (len(header) - 2)]
    for part, found in content.items():
        (unit, per, words), rows = UNIT[part], np.array(found["rows"])
        late = rows[len(rows) // 2 :]
        slope = np.polyfit(late[:, 0], late[:, 1], 1)[0] * per
        span = f"{rows[0, 0]:.0f} … {rows[-1, 0]:.0f} {unit}"
        ends = [f"{first:.0f} … {last:.0f}" for first, last in zip(rows[0, 1:], rows[-1, 1:], strict=True)]
        lines.append([part, span, *ends, f"{slope:+.0f} MB in {words}"])
    text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    made = "; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items())
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{text}\n\nMade with {made}.\n{END}{rest.partition(END)[2]}", encoding="utf-8")


def main(part: Annotated[Part, tyro.conf.Positional], num: int = 2000, minutes: float = 60.0) -> None:
    """Run one part, keep its rows and write the page."""
    content = json.loads(DATA.read_text(encoding="utf-8")) if DATA.is_file() else {}
    if part == "page":
        write_page(content)
        return
    with tempfile.TemporaryDirectory() as folder:
        tempfile.tempdir = folder
        rows, done = soak_scenes(num, Path(folder)) if part == "scenes" else soak_studio(minutes, Path(folder))
        tempfile.tempdir = None
    content[part] = {"rows": np.round(rows, 2).tolist(), "done": dict(done)}
    DATA.write_text(json.dumps(dict(sorted(content.items())), indent=1) + "\n", encoding="utf-8")
    write_page(content)
    print(dict(done))


if __name__ == "__main__":
    tyro.cli(main)
