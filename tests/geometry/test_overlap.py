"""Depth of one body in another, on boxes and balls whose overlap is known."""

import numpy as np
import pytest
import trimesh

from dexnudge.geometry.overlap import deepest_overlap


def block(centre, size) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(centre)
    return mesh


@pytest.mark.parametrize("depth", [0.0005, 0.003, 0.02])
def test_a_ball_sunk_into_a_slab(depth):
    ball = trimesh.creation.icosphere(3, 0.05)
    ball.apply_translation([0, 0, -ball.bounds[0, 2] - depth])
    found, point, way = deepest_overlap(ball, block((0, 0, -0.05), (1, 1, 0.1)))
    assert found == pytest.approx(depth, rel=0.02)
    assert np.linalg.norm(point[:2]) < 0.02
    np.testing.assert_allclose(way, [0, 0, depth], atol=0.02 * depth)


def test_a_thin_rod_through_the_middle_of_a_plate_is_found():
    plate = block((0, 0, 0), (0.3, 0.2, 0.02))
    rod = block((0.01, 0.02, 0), (0.006, 0.006, 0.5))  # no vertex of either is inside the other
    assert deepest_overlap(plate, rod)[0] > 0.002


def test_bodies_apart_and_bodies_that_touch_do_not_overlap():
    slab = block((0, 0, -0.05), (1, 1, 0.1))
    assert deepest_overlap(block((0, 0, 0.5), (0.1, 0.1, 0.1)), slab)[0] == 0
    assert deepest_overlap(block((0, 0, 0.05), (0.1, 0.1, 0.1)), slab)[0] < 1e-6


def test_an_object_wholly_inside_is_found_both_ways():
    small, large = block((0, 0, 0), (0.02, 0.02, 0.02)), block((0, 0, 0), (0.2, 0.2, 0.2))
    assert deepest_overlap(small, large)[0] == pytest.approx(0.1, abs=0.011)
    assert deepest_overlap(large, small)[0] == pytest.approx(0.1, abs=0.011)
