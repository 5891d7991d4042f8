"""Prisms over outlines, and the smallest rectangle around one."""

import numpy as np
import pytest

from dexnudge.perception.masked_object import prism, smallest_rectangle


def test_a_prism_is_closed_and_outward_whichever_way_its_outline_runs():
    outline = np.array([[0, 0], [0.1, 0], [0.1, 0.05], [0, 0.05]])
    for each in (outline, outline[::-1]):
        mesh = prism(each, 0.02)
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(0.1 * 0.05 * 0.02)
        np.testing.assert_allclose(mesh.bounds[:, 2], [-0.01, 0.01])


def test_the_smallest_rectangle_of_a_turned_one_is_itself():
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    outline = np.array([[0, 0], [0.1, 0], [0.1, 0.05], [0, 0.05]]) @ turn.T + [0.2, -0.1]
    corner, sides, axes = smallest_rectangle(outline, [])
    np.testing.assert_allclose(sides, [0.1, 0.05])
    assert np.abs(axes @ axes.T - np.eye(2)).max() < 1e-12
    assert np.linalg.norm(outline - corner, axis=1).min() < 1e-12
    np.testing.assert_allclose(corner + sides / 2 @ axes, outline.mean(axis=0))
    along_x = smallest_rectangle(outline, [np.array([1.0, 0.0])])[1]
    assert along_x.prod() > 0.1 * 0.05
