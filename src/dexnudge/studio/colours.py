"""Colours as the studio's page must be given them, so that they look as in pictures."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8

from dexnudge.viewer.picture import linear_colour

# three.js shows linear light by the ACES film curve (S. Hill's fit): light over 0.6, a matrix, (v (v + a) - b) / (v (c v +
# d) + e) of each channel, a matrix. It makes colours darker and paler.
EXPOSED = 0.6
TO_FILM = np.array([[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]])
FROM_FILM = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]])
CURVE = (0.0245786, 0.000090537, 0.983729, 0.4329510, 0.238081)
BRIGHTEST = 0.9  # of the curve, which comes to 1 at endless light only


def sent_colour(srgb: Float[np.ndarray, "*n 3"]) -> UInt8[np.ndarray, "*n 3"]:
    """Return bytes, which the page takes for linear light, that make a body in full light look of an sRGB colour (0..1).

    Colours that the film curve cannot show become the nearest that it can, channel by channel.
    """
    a, b, c, d, e = CURVE
    y = np.clip(linear_colour(srgb) @ np.linalg.inv(FROM_FILM).T, 0.0, BRIGHTEST)
    # y = (v (v + a) - b) / (v (c v + d) + e), solved for v >= 0.
    square, linear, constant = 1 - c * y, a - d * y, -b - e * y
    v = (-linear + np.sqrt(linear**2 - 4 * square * constant)) / (2 * square)
    return np.rint(255 * np.clip(EXPOSED * v @ np.linalg.inv(TO_FILM).T, 0.0, 1.0)).astype(np.uint8)
