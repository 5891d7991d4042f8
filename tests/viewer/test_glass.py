"""Pages show as glass what of a robot stands before object or hand from where one looks, in a real browser."""

import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image

from dexnudge.viewer.page import write_recording_page
from dexnudge.viewer.recording import Recording
from dexnudge.viewer.visual_scene import Part, VisualScene

pytestmark = pytest.mark.slow
SIZE = (900, 600)
TURNED = 0.008  # [rad] by which a page turns for each pixel of a drag
LOW = 0.15  # [rad] elevation from which a wall hides the whole object
WALLS = {"east": (0.1, 0.0), "north": (0.0, 0.1), "west": (-0.1, 0.0), "south": (0.0, -0.1)}
COLOURS = {"east": (1.0, 0.0, 0.0), "north": (0.0, 1.0, 0.0), "west": (0.0, 0.0, 1.0), "south": (1.0, 0.0, 1.0)}
BLOCK = (1.0, 0.9, 0.0)


@pytest.fixture(scope="module")
def walled() -> Recording:
    """A block between four upright links, two of an arm and two forearms, of which the southern comes at the end only."""
    block = Part("object", "object", trimesh.creation.box((0.03, 0.03, 0.03)), np.eye(4), BLOCK)
    tip = trimesh.creation.box((0.01, 0.01, 0.01))
    raised = trimesh.transformations.translation_matrix([0.0, 0.0, 0.02])
    parts = [block, Part("tip", "fingertip", tip, raised, (0.9, 0.9, 0.9))]
    for name, (x, y) in WALLS.items():
        mesh = trimesh.creation.box((0.02, 0.14, 0.12) if x else (0.14, 0.02, 0.12))
        pose = trimesh.transformations.translation_matrix([x, y, 0.0])
        parts.append(Part(name, "arm" if x else "base", mesh, pose, COLOURS[name]))
    first = VisualScene(tuple(parts), np.zeros((0, 3)), np.zeros(3))
    away = replace(parts[-1], T_world_part=trimesh.transformations.translation_matrix([0.0, -0.1, -0.3]))
    before = replace(first, parts=(*parts[:-1], away))
    return Recording([before, before, first], np.array([0.0, 1.0, 2.0]), ["", "", ""], {})


def seen(page, camera, azimuth: float, elevation: float) -> set[str]:
    """Return which walls are seen solid, and the block if it is seen, after the view was turned there.

    Glass is a quarter of its colour, which leaves three quarters of what is behind.
    """
    page.mouse.dblclick(200, 300)  # as it was at first
    right, down = (camera["azimuth"] - azimuth) / TURNED, (elevation - camera["elevation"]) / TURNED
    for _ in range(5):  # the pointer stays in the window
        page.mouse.move(200, 300)
        page.mouse.down()
        page.mouse.move(200 + right / 5, 300 + down / 5)
        page.mouse.up()
    page.wait_for_timeout(500)
    shot = Image.open(io.BytesIO(page.locator("#stage").screenshot())).convert("RGB")
    pixels = np.asarray(shot).reshape(-1, 3).astype(int)
    found = set()
    for name, colour in {**COLOURS, "block": BLOCK}.items():
        of_it = np.array(colour) > 0.5
        strength = pixels[:, of_it].min(axis=1) - pixels[:, ~of_it].max(axis=1)
        if (strength > (60 if name == "block" else 130)).sum() > 100:
            found.add(name)
    return found


def test_what_stands_between_is_glass_and_the_rest_solid(walled, browser, tmp_path):
    path = write_recording_page(walled, tmp_path / "film.html")
    camera = json.loads(re.search(r'id="data">(.*?)</script>', path.read_text())[1])["camera"]
    with browser.opened_page(path.as_uri(), size=SIZE) as page:
        for name, (x, y) in WALLS.items():  # the southern one hides nothing yet, and is glass all the same
            shown = seen(page, camera, float(np.arctan2(y, x)), LOW)
            assert "block" in shown, name
            assert name not in shown, name
        assert {"block", "east", "north", "west"} <= seen(page, camera, 0.3, 1.4)  # from above none is before it
