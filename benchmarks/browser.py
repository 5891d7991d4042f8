"""A headless Chromium that looks at the studio: it counts frames and draw calls, and finds controls by their labels.

The browser is that of CHROMIUM, or a `chromium` on the PATH. Software draws unless there is a graphics card: Mesa's OpenGL
is several times as fast there as Chromium's own SwiftShader, which stands in where Mesa is missing.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Locator, Page, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle={}",
    "--ignore-gpu-blocklist",
    "--enable-unsafe-swiftshader",
)
SIZE = (1280, 800)
PATIENCE = 120.0  # [s] of a busy machine without a graphics card
# Counts draw calls, and notes when the first instanced one came: viser draws nothing instanced before our bodies are there.
COUNTING = """
window.drawn = {calls: 0, first: null};
for (const name of ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"]) {
  const original = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) {
    window.drawn.calls += 1;
    if (window.drawn.first === null && name.endsWith("Instanced")) window.drawn.first = performance.now();
    return original.apply(this, given);
  };
}"""
# The view is turned by viser's own camera controls: it draws only when something changes.
FRAMES = """async seconds => {
  const controls = window.__viserMutable.cameraControl, start = performance.now();
  let frames = 0, before = window.drawn.calls, calls = 0, passed = 0;
  while (passed < seconds) {
    controls.rotate(0.02, 0, false);
    await new Promise(requestAnimationFrame);
    if (window.drawn.calls > before) { frames += 1; calls = window.drawn.calls - before; before = window.drawn.calls; }
    passed = (performance.now() - start) / 1000;
  }
  return [frames / passed, calls];
}"""


def chromium() -> str | None:
    """Return the browser's path; None where there is none."""
    return os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)


@contextmanager
def opened_page(url: str, *, angle: str = "gl", size: tuple[int, int] = SIZE) -> Iterator[Page]:
    """Yield a page of a size in pixels that has opened `url`."""
    with sync_playwright() as playwright:
        arguments = [argument.format(angle) for argument in ARGUMENTS]
        browser = playwright.chromium.launch(executable_path=chromium(), args=arguments)
        page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.set_default_timeout(1e3 * PATIENCE)
        page.add_init_script(COUNTING)
        page.goto(url)
        yield page
        browser.close()


def first_frame(page: Page) -> float:
    """Return the seconds from the page's beginning to its first frame with our bodies."""
    page.wait_for_function("window.drawn.first !== null")
    return page.evaluate("window.drawn.first") / 1e3


def frame_rate(page: Page, *, seconds: float = 5.0) -> tuple[float, int]:
    """Return frames a second and draw calls a frame while the view is turned."""
    rate, calls = page.evaluate(FRAMES, seconds)
    return rate, calls


def tab(page: Page, name: str) -> None:
    """Open a tab."""
    page.get_by_role("tab", name=name, exact=True).click()


def toggle(page: Page, label: str) -> None:
    """Click a checkbox by its label."""
    page.locator("label:visible", has_text=label).first.click()


def choose(page: Page, label: str, option: str) -> None:
    """Choose from a dropdown by its label; `option` is what the entry begins with."""
    control(page, label).click()
    page.locator("[role=option]:visible").filter(has_text=option).first.click()


def control(page: Page, label: str) -> Locator:
    """Return the input that a label belongs to."""
    found = page.locator("label:visible").filter(has_text=label).first
    return page.locator(f'[id="{found.get_attribute("for")}"]')


def fill(page: Page, label: str, value: object) -> None:
    """Type into a field, or into that beside a slider, by its label."""
    row = page.locator("label:visible").filter(has_text=label).first.locator("xpath=../../..")
    row.locator("input:not([type=hidden])").last.fill(str(value))
    page.keyboard.press("Enter")


def press(page: Page, name: str) -> None:
    """Click a button by its text."""
    page.locator("button:visible").filter(has_text=name).first.click()
