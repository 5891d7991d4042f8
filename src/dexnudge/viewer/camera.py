"""A pinhole camera, and how far back it must stand so that points fill the picture."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

TAN_HALF_HEIGHT = 0.26  # tangent of half the vertical angle of view (29 deg in all): little perspective distortion
FILLED = 0.76  # of the picture's width or height that the framed points take; the rest shows the surroundings


@dataclass(frozen=True, eq=False)
class Camera:
    """Position [m] and axes in the world; a pixel's ray goes along forward + x tan_width right + y tan_height up.

    x runs from -1 (left) to 1, y from -1 (bottom) to 1.
    """

    position: Float[np.ndarray, "3"]
    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    forward: Float[np.ndarray, "3"]
    tan_width: float
    tan_height: float

    @property
    def azimuth(self) -> float:
        """Direction from what is seen to the camera, from x towards y [rad]."""
        return float(np.arctan2(-self.forward[1], -self.forward[0]))

    @property
    def elevation(self) -> float:
        """The same above the horizon [rad]."""
        return float(np.arcsin(-self.forward[2]))

    def rays(self, size: tuple[int, int]) -> Float[np.ndarray, "pixel 3"]:
        """Return unit directions through the centres of all pixels of a picture (width, height), row by row from the top."""
        width, height = size
        x = (np.arange(width) + 0.5) / width * 2 - 1
        y = 1 - (np.arange(height) + 0.5) / height * 2
        rays = (
            self.forward
            + (self.tan_width * x)[None, :, None] * self.right
            + (self.tan_height * y)[:, None, None] * self.up
        ).reshape(-1, 3)
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def framing_camera(points: Float[np.ndarray, "n 3"], *, azimuth: float, elevation: float, aspect: float) -> Camera:
    """Return the nearest camera in a given direction that sees all `points` [m] with a margin.

    Args:
        points: what must be in view [m].
        azimuth: direction from the points to the camera, from x towards y [rad].
        elevation: the same above the horizon [rad]; below a right angle.
        aspect: width of the picture over its height.
    """
    backward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.cross([0.0, 0.0, 1.0], backward)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(backward, right), backward])
    local = points @ axes.T
    tangents = np.array([TAN_HALF_HEIGHT * aspect, TAN_HALF_HEIGHT])
    # A point is in view where |x - x_camera| <= tangent (z_camera - z): two planes for each axis.
    reach = FILLED * tangents
    high = (local[:, :2] + reach * local[:, 2:]).max(axis=0)
    low = (local[:, :2] - reach * local[:, 2:]).min(axis=0)
    distance = ((high - low) / (2 * reach)).max()
    position = np.array([*(high + low) / 2, distance])
    return Camera(position @ axes, right, axes[1], -backward, float(tangents[0]), float(tangents[1]))
