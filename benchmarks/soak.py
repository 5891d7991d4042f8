"""Long use: every control of the studio clicked for some minutes, and many scenes sampled in one process.

    python benchmarks/soak.py --studio-minutes 5 --scenes 200

Prints memory (RSS) over time and what is left in the temporary folder. What grows without end is a leak.
"""

import argparse
import gc
import random
import tempfile
import time
from contextlib import closing
from pathlib import Path

from browser import PATIENCE, control, first_frame, opened_page
from playwright.sync_api import Error, Page

import dexnudge as dn
from dexnudge.studio.studio import Studio

TABS = ("Draws", "Play", "Sample", "View")
NOT_CLICKED = ("Build", "Save")  # these would begin anew, and write
FAMILIES = ("table", "layers", "shelf")
DRAWS = 4


def memory() -> float:
    """Return the memory of this process [MB]."""
    gc.collect()
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.partition("VmRSS:")[2].split()[0]) / 2**10


def leftovers() -> int:
    """Return how many files and folders the temporary folder holds."""
    return sum(1 for _ in Path(tempfile.gettempdir()).iterdir())


def click_around(page: Page, generator: random.Random) -> None:
    """Use one control of a tab that is chosen by chance."""
    page.get_by_role("tab", name=generator.choice(TABS), exact=True).click()
    found = [*page.locator("button:visible:not([disabled])").all(), *page.locator("label:visible").all()]
    chosen = generator.choice(found)
    text = chosen.inner_text()
    if text.startswith(NOT_CLICKED):
        return
    chosen.click(timeout=1e3 * PATIENCE / 4)
    options = page.locator("[role=option]:visible").all()
    if options:
        generator.choice(options).click()
    elif page.locator("label:visible").filter(has_text=text).count() and control(page, text).count():
        page.keyboard.press(generator.choice(["ArrowLeft", "ArrowRight", "Home", "End"]))


def soak_studio(minutes: float) -> None:
    """Click every control of a studio."""
    scene = dn.build_scene("shelf", "phone", seed=0)
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder, "out")
        dn.Sampler(dn.load_hand("shadow_lite")).sample(scene, num=16, seed=0).save(result)
        with closing(Studio(result, port=0, out=folder)) as studio, opened_page(studio.url) as page:
            first_frame(page)
            generator, clicks, refused = random.Random(0), 0, 0  # noqa: S311 - where to click is no secret
            start = shown = time.monotonic()
            print(f"studio: {memory():.0f} MB at the beginning")
            while time.monotonic() - start < 60 * minutes:
                try:
                    click_around(page, generator)
                    clicks += 1
                except Error:  # a control that was covered, or went away, meanwhile
                    refused += 1
                    page.keyboard.press("Escape")
                if time.monotonic() - shown > 30:
                    shown = time.monotonic()
                    print(
                        f"  {(shown - start) / 60:.1f} min, {clicks} clicks, {refused} missed: {memory():.0f} MB",
                        flush=True,
                    )


def soak_scenes(count: int) -> None:
    """Sample many small scenes."""
    sampler, before = dn.Sampler(dn.load_hand("shadow_lite")), leftovers()
    for number in range(count):
        scene = dn.build_scene(FAMILIES[number % len(FAMILIES)], "phone", seed=number)
        sampler.sample(scene, num=DRAWS, seed=number)
        if (number + 1) % max(1, count // 20) == 0:
            print(f"  {number + 1} scenes: {memory():.0f} MB, {leftovers() - before:+d} temporary files", flush=True)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studio-minutes", type=float, default=0.0)
    parser.add_argument("--scenes", type=int, default=0)
    options = parser.parse_args()
    if options.studio_minutes:
        soak_studio(options.studio_minutes)
    if options.scenes:
        soak_scenes(options.scenes)


if __name__ == "__main__":
    main()
