"""Colours that are sent, shown as three.js shows them: its ACES curve, then sRGB."""

import numpy as np
import pytest

from dexnudge.studio.colours import sent_colour
from dexnudge.viewer.visual_scene import PALETTE


def three_js(light):
    """What a pixel of linear light shows (three.js r17x, tonemapping_pars_fragment.glsl and colorspace_pars_fragment)."""
    red, green, blue = np.asarray(light) / 0.6
    film = np.array(
        [
            0.59719 * red + 0.35458 * green + 0.04823 * blue,
            0.07600 * red + 0.90834 * green + 0.01566 * blue,
            0.02840 * red + 0.13383 * green + 0.83777 * blue,
        ]
    )
    red, green, blue = (film * (film + 0.0245786) - 0.000090537) / (film * (0.983729 * film + 0.4329510) + 0.238081)
    shown = np.array(
        [
            1.60475 * red - 0.53108 * green - 0.07367 * blue,
            -0.10208 * red + 1.10813 * green - 0.00605 * blue,
            -0.00327 * red - 0.07276 * green + 1.07602 * blue,
        ]
    ).clip(0, 1)
    return np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("role", ["object", "link", "fingertip", "base", "environment", "arrow", "support", "obstacle"])
def test_a_body_in_full_light_has_its_colour(role):
    assert three_js(sent_colour(np.array(PALETTE[role])) / 255) == pytest.approx(PALETTE[role], abs=0.012)


def test_colours_beyond_the_curve_are_the_nearest():
    white, yellow, black = (
        three_js(sent_colour(np.array(each)) / 255) for each in ([1.0] * 3, [1.0, 1.0, 0.0], [0.0] * 3)
    )
    assert white == pytest.approx(three_js([1.0] * 3), abs=1e-3)  # as bright as the page's light makes anything
    assert yellow[:2].min() > 0.85
    assert yellow[2] < 0.5
    assert black.max() < 0.01
