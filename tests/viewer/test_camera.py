import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from dexnudge.viewer.camera import FILLED, choose_camera, framing_camera
from dexnudge.viewer.visual_scene import Part, VisualScene


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


def test_a_book_that_comes_out_of_a_row_is_seen_from_beside_the_row():
    """From the front nothing hides it, but neither its tip nor its way can be seen."""

    def box(role, size, place):
        return Part(role, role, trimesh.creation.box(size), trimesh.transformations.translation_matrix(place))

    motion = np.array([1.0, 0, 0])
    row = [box("object", (0.08, 0.01, 0.15), (0, 0, 0))]
    row += [box("environment", (0.08, 0.05, 0.15), (0, side, 0)) for side in (-0.035, 0.035)]
    row += [box("ghost", (0.08, 0.01, 0.15), (0.1, 0, 0)), box("fingertip", (0.01, 0.01, 0.02), (-0.03, 0, 0.085))]
    camera = choose_camera(VisualScene(tuple(row), np.zeros((0, 3)), motion), aspect=4 / 3)
    assert abs(camera.forward @ motion) < np.cos(np.radians(55.0))
