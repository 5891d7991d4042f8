"""How an object with two feet comes to rest at an edge, by trigonometry."""

from dataclasses import replace

import numpy as np
import pytest
from trimesh.transformations import rotation_matrix

from dexnudge.planning.lying_object import LyingObject
from dexnudge.planning.object_path import station
from dexnudge.scenes.boxes import box, joined
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import SUPPORT_DISTANCE

LENGTH, FOOT = 0.12, 0.01  # [m] of the bar, and of each foot at its two ends


def bridge(height: float) -> Scene:
    """A bar on two feet of `height` [m], flush with the table's edge at x = 0, to be moved over it."""
    bar = box((-LENGTH, -0.02, height), (0.0, 0.02, height + 0.01))
    feet = [box((x, -0.02, 0.0), (x + FOOT, 0.02, height)) for x in (-LENGTH, -FOOT)]
    mesh = joined([bar, *feet])
    table = box((-0.5, -0.3, -0.04), (0.0, 0.3, 0.0))
    return Scene(mesh, table, np.eye(4), np.array([1.0, 0.0, 0.0]))


@pytest.mark.parametrize("way", [0.0, 0.005])
def test_on_both_feet_it_stays_as_it_is(way):
    rest = LyingObject(bridge(0.004)).at_rest(np.array([way, 0.0, 0.0]), least=0.004)
    np.testing.assert_array_equal(rest.T_rocked, np.eye(4))
    assert rest.margin == pytest.approx(0.02, abs=0.001)  # to its sides


def test_with_one_foot_over_the_edge_it_rocks_onto_its_underside():
    way, height = 0.02, 0.004
    rest = LyingObject(bridge(height)).at_rest(np.array([way, 0.0, 0.0]), least=0.0)
    heel = -LENGTH + FOOT + way  # the remaining foot's front edge, about which it turns
    turned_x, _, turned_z = rest.T_rocked[:3, 0]
    # It may stop short by the distance at which a contact counts, and its points are 5 mm apart.
    assert (height - SUPPORT_DISTANCE) / -heel <= -turned_z <= height / (-heel - 0.005)
    assert turned_x == pytest.approx(np.cos(np.arcsin(turned_z)))
    np.testing.assert_allclose(rest.T_rocked @ [heel, 0.01, 0.0, 1.0], [heel, 0.01, 0.0, 1.0], atol=6e-4)
    assert rest.margin == pytest.approx(0.02, abs=0.001)


def test_what_carries_it_then_reaches_from_its_heel_to_the_edge():
    way = 0.02
    points = station(bridge(0.004), way).supports.points[:, 0] + way
    assert points.max() == pytest.approx(0.0, abs=0.003)
    assert points.min() <= -LENGTH + FOOT + way + 1e-6


def test_beyond_its_centre_nothing_holds_it():
    rest = LyingObject(bridge(0.004)).at_rest(np.array([LENGTH / 2 + 0.01, 0.0, 0.0]), least=0.0)
    assert rest.margin < -0.005


def test_on_feet_so_tall_that_it_would_lean_far_it_tips():
    rest = LyingObject(bridge(0.02)).at_rest(np.array([0.02, 0.0, 0.0]), least=0.0)
    assert rest.margin < 0
    np.testing.assert_array_equal(rest.T_rocked, np.eye(4))


@pytest.mark.parametrize("least", [0.0, 0.004])
@pytest.mark.parametrize("lean", [0.0, 0.02])
@pytest.mark.parametrize("height", [1e-6, 0.004])  # lying flat, or on its feet
def test_a_few_points_say_nothing_that_all_of_them_deny(least, lean, height):
    T_lean, scene = rotation_matrix(lean, [0, 1, 0]), bridge(height)
    leaning = scene.environment_mesh.copy().apply_transform(T_lean)
    lying = LyingObject(replace(scene, environment_mesh=leaning, T_world_object=T_lean))
    for shift in np.linspace([0.0, 0.0, 0.0], [LENGTH, 0.0, 0.0], 25):
        assert lying.keeps_balance(shift, least=least) == (lying.at_rest(shift, least=least).margin >= least)
        np.testing.assert_array_equal(lying.rocked(shift), lying.at_rest(shift, least=0.0).T_rocked)
