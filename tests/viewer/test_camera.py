import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dexnudge.viewer.camera import FILLED, framing_camera


def in_picture(camera, points):
    """Place of points in the picture, from -1 to 1, by similar triangles."""
    lines = points - camera.position
    depth = lines @ camera.forward
    x = lines @ camera.right / (depth * camera.tan_width)
    y = lines @ camera.up / (depth * camera.tan_height)
    return x, y, depth


@settings(deadline=None, max_examples=50)
@given(
    seed=st.integers(0, 10_000),
    azimuth=st.floats(-3.2, 3.2),
    elevation=st.floats(-1.4, 1.4),
    aspect=st.floats(0.5, 2.5),
)
def test_framed_points_fill_the_picture_and_no_more(seed, azimuth, elevation, aspect):
    points = np.random.default_rng(seed).normal(size=(20, 3)) * [0.2, 0.1, 0.05]
    camera = framing_camera(points, azimuth=azimuth, elevation=elevation, aspect=aspect)
    x, y, depth = in_picture(camera, points)
    assert (depth > 0).all()
    assert max(np.abs(x).max(), np.abs(y).max()) == pytest.approx(FILLED, abs=1e-9)


def test_axes_are_right_handed_and_the_picture_stands_upright():
    camera = framing_camera(np.eye(3), azimuth=0.7, elevation=0.4, aspect=4 / 3)
    np.testing.assert_allclose(np.cross(camera.right, camera.up), -camera.forward, atol=1e-12)
    assert camera.right[2] == pytest.approx(0.0)
    assert camera.up[2] > 0
    assert camera.position @ [np.cos(0.7), np.sin(0.7), 0] > 0


def test_rays_go_through_the_centres_of_the_pixels():
    camera = framing_camera(np.eye(3), azimuth=0.0, elevation=0.3, aspect=2.0)
    rays = camera.rays((4, 2))
    x, y, _ = in_picture(camera, camera.position + rays)
    np.testing.assert_allclose(x, [-0.75, -0.25, 0.25, 0.75] * 2, atol=1e-12)
    np.testing.assert_allclose(y, [0.5] * 4 + [-0.5] * 4, atol=1e-12)
