"""Planes are found where they are, with the noise that their points have."""

import numpy as np
import pytest
import trimesh

from dexnudge.perception.completion import complete
from dexnudge.perception.planes import find_planes, merged_points

LOW, HIGH = np.array([-0.35, -0.35, -0.3]), np.array([0.35, 0.35, 0.4])
EYES = [(-0.45, 0.3, 0.5), (-0.5, -0.25, 0.45)]
TABLE = ((-0.3, -0.25, -0.02), (0.3, 0.25, 0.0))
PHONE = ((0.0, -0.035, 0.0), (0.15, 0.035, 0.03))


def test_a_table_and_a_wall_are_found_where_they_are(corner):
    table, wall = find_planes(corner, LOW, HIGH)[:2]
    np.testing.assert_allclose(table.normal, [0, 0, 1], atol=0.01)
    assert table.offset == pytest.approx(0, abs=1e-3)
    np.testing.assert_allclose(wall.normal, [-1, 0, 0], atol=0.02)
    assert wall.offset == pytest.approx(-0.3, abs=2e-3)
    assert max(table.noise, wall.noise) < 2e-3


@pytest.mark.parametrize("degrees", [0.0, 2.0])
def test_noise_and_tilt_are_those_of_the_table(see, made_of, degrees):
    turn = trimesh.transformations.rotation_matrix(np.radians(degrees), [0, 1, 0])
    table, phone = made_of(TABLE).apply_transform(turn), made_of(PHONE).apply_transform(turn)
    views = see(phone, table, [(-0.4, 0.2, 0.6), (-0.4, -0.2, 0.6)], (0.0, 0, 0), noise=1.0)
    plane = find_planes(views, LOW, HIGH)[0]
    assert np.degrees(np.arccos(plane.normal @ turn[:3, 2])) < 0.3
    assert abs(plane.offset) < 1e-3
    assert 5e-4 < plane.noise < 2.5e-3


def test_what_is_no_plane_gives_none(corner, made_of, see):
    ball = trimesh.creation.icosphere(radius=0.05)
    views = see(ball, made_of(((5, 5, 5), (6, 6, 6))), EYES, (0, 0, 0))
    assert find_planes(views, LOW, HIGH) == []
    assert complete(views, []) == views
    assert len(find_planes(corner, HIGH, HIGH + 0.1)) == 0


def test_merged_points_are_thinned_and_inside(corner):
    points = merged_points(corner, LOW, np.array([0.1, 0.1, 0.1]))
    assert (points >= LOW).all()
    assert (points <= 0.1).all()
    assert len(points) < 0.5 * sum(view.measured.sum() for view in corner)
