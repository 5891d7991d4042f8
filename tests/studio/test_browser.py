"""The page in a real browser. Where Chromium is missing, these are skipped."""

import re

import numpy as np
import pytest
from PIL import Image

from dexnudge.viewer.visual_scene import PALETTE

pytestmark = pytest.mark.slow
SIZE = (800, 600)


def test_the_page_shows_draws_plays_and_samples(studio, browser, result):
    said = []
    studio.session.tell = lambda *message: said.append(message)
    with browser.opened_page(studio.url, size=SIZE) as page:
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        browser.first_frame(page)
        body = page.locator("body")
        assert "<b>phone<b>" in body.inner_text()  # the folder's name, as text
        assert str(result.parent) not in page.content()
        calls = page.evaluate("window.drawn.calls")

        browser.press(page, "next")
        page.wait_for_function("calls => window.drawn.calls > calls", arg=calls)
        page.get_by_text(re.compile("^1$")).first.wait_for()
        assert studio.session.place == 1

        browser.toggle(page, "all of them together")
        page.get_by_text("drawn", exact=True).first.wait_for()
        assert studio.session.together

        browser.tab(page, "Play")
        assert browser.control(page, "play").input_value() == "execution/configuration_000"  # the only one is chosen
        browser.press(page, "Play")
        page.get_by_text("0.04 s").first.wait_for()

        browser.tab(page, "Sample")
        browser.fill(page, "draws", 4)
        browser.press(page, "Sample")
        for _ in range(600):  # until what was clicked has come here, and is done
            page.wait_for_timeout(200)
            if len(studio.session.samples) == 4 and not studio.session.busy:
                break
        assert len(studio.session.samples) == 4
        page.get_by_text(f"{studio.session.samples.num_verified} of 4 verified").first.wait_for()
        browser.choose(page, "result", studio.session.name)
        page.wait_for_timeout(2000)
        assert len(studio.session.samples) == 8
        assert not errors
        assert not said


def test_a_picture_is_downloaded_and_the_object_has_its_colour(studio, browser, tmp_path):
    with browser.opened_page(studio.url, size=SIZE) as page:
        browser.first_frame(page)
        browser.tab(page, "View")
        with page.expect_download() as download:
            browser.press(page, "Save the picture")
        download.value.save_as(tmp_path / "picture.png")
    pixels = np.asarray(Image.open(tmp_path / "picture.png").convert("RGB")).reshape(-1, 3).astype(int)
    assert len(np.unique(pixels, axis=0)) > 50  # something was drawn
    orange = pixels[(pixels[:, 0] > pixels[:, 1] + 40) & (pixels[:, 1] > pixels[:, 2] + 15)]
    colours, counts = np.unique(orange, axis=0, return_counts=True)
    assert counts.max() > 500  # its upper side
    assert colours[counts.argmax()] == pytest.approx(255 * np.array(PALETTE["object"]), abs=20)


# Of viser's own camera: the vertical angle of view [rad], and width and height of what it fills [pixels].
CAMERA = """() => {
  const { cameraControl, canvas } = window.__viserMutable;
  return [cameraControl.camera.fov * Math.PI / 180, canvas.clientWidth, canvas.clientHeight];
}"""
FITTED = """([width, tangent]) => {
  const { cameraControl, canvas } = window.__viserMutable;
  const seen = Math.tan(cameraControl.camera.fov * Math.PI / 360) * canvas.clientWidth / canvas.clientHeight;
  return canvas.clientWidth < width && Math.abs(seen / tangent - 1) < 0.01;
}"""
AS_BEFORE = "angle => Math.abs(window.__viserMutable.cameraControl.camera.fov * Math.PI / 180 - angle) < 0.002"


def test_a_window_that_narrows_goes_on_showing_the_same_width(studio, browser):
    with browser.opened_page(studio.url, size=(1200, 600)) as page:
        browser.first_frame(page)
        angle, width, height = page.evaluate(CAMERA)
        assert width / height > 4 / 3
        page.set_viewport_size({"width": 800, "height": 600})
        page.wait_for_function(FITTED, arg=[width, np.tan(angle / 2) * 4 / 3])
        narrow, width, height = page.evaluate(CAMERA)
        assert width / height < 4 / 3
        assert narrow > angle + 0.05
        page.set_viewport_size({"width": 1200, "height": 600})
        page.wait_for_function(AS_BEFORE, arg=angle)
