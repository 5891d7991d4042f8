"""Holes are completed by planes where these are what is there, and only there."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, minimum_filter

from dexnudge.perception.completion import bridged, complete
from dexnudge.perception.planes import find_planes

LOW, HIGH = np.array([-0.35, -0.35, -0.3]), np.array([0.35, 0.35, 0.4])


def without(view, pixels):
    return replace(view, depth=np.where(pixels, 0.0, view.depth))


def at(view, places) -> np.ndarray:
    """Pixels nearest to world points."""
    u, v = np.rint(view.project(np.array(places, dtype=float))[:, :2]).astype(int).T
    pixels = np.zeros(view.depth.shape, dtype=bool)
    pixels[v, u] = True
    return pixels


def test_a_hole_in_the_floor_becomes_assumed_floor(corner):
    hole = [
        at(view, [(x, y, 0.0) for x in np.linspace(-0.2, -0.05, 80) for y in np.linspace(-0.1, 0.1, 80)])
        for view in corner
    ]
    holed = [without(view, pixels) for view, pixels in zip(corner, hole, strict=True)]
    done = complete(holed, find_planes(holed, LOW, HIGH))
    for view, before, pixels in zip(done, holed, hole, strict=True):
        assert view.assumed[pixels].mean() > 0.99
        assert np.abs(view.points(pixels)[:, 2]).max() < 2e-3
        places = before.points()
        rows, columns = np.nonzero(before.measured)
        surface = np.minimum(np.abs(places[:, 2]), np.abs(places[:, 0] - 0.3)) < 1e-3
        surface &= (places[:, 0] < 0.301) & (np.abs(places[:, 1]) < 0.24)  # not the narrow sides of the boxes
        unchanged = np.zeros_like(before.mask)
        unchanged[rows[surface], columns[surface]] = True
        unchanged &= ~before.mask
        np.testing.assert_array_equal(view.depth[unchanged], before.depth[unchanged])


def test_pixels_of_the_object_show_what_is_behind(corner):
    done = complete(corner, find_planes([without(view, view.mask) for view in corner], LOW, HIGH))
    points = np.concatenate([view.points(view.mask) for view in done])
    assert len(points) > 0.97 * sum((view.mask & view.measured).sum() for view in corner)
    off = np.minimum(np.abs(points[:, 2]), np.abs(points[:, 0] - 0.3))
    assert off.max() < 3e-3
    assert all(view.assumed[view.mask & view.measured].all() for view in done)


def test_beyond_the_edge_of_a_table_nothing_is_assumed(corner):
    """Beside the table, where other rays go past it, its plane is no surface."""
    beside = [(x, y, 0.0) for x in np.linspace(-0.2, 0.2, 30) for y in (-0.32, -0.29, 0.29, 0.32)]
    pixels = [at(view, [place for place in beside if view.sees(np.array([place]))[0]]) for view in corner]
    holed = [without(view, hole) for view, hole in zip(corner, pixels, strict=True)]
    for view, hole in zip(complete(holed, find_planes(holed, LOW, HIGH)), pixels, strict=True):
        assert hole.sum() > 10
        assert (np.abs(view.points(hole)[:, 2]) > 0.02).all()


def test_an_opening_through_which_something_was_seen_stays_open(see, made_of):
    """A floor with a slot, and a second floor below: the slot's unmeasured pixels belong to neither floor's patch."""
    left, right = ((-0.3, -0.25, -0.02), (0.3, -0.05, 0.0)), ((-0.3, 0.05, -0.02), (0.3, 0.25, 0.0))
    below = ((-0.3, -0.25, -0.22), (0.3, 0.25, -0.2))
    views = see(
        made_of(((0.0, 0.1, 0), (0.1, 0.2, 0.03))),
        made_of(left, right, below),
        [(-0.3, 0, 0.6), (0.3, 0, 0.6)],
        (0, 0, 0),
    )
    specks = [at(view, [(x, 0.0, 0.0) for x in np.linspace(-0.2, 0.2, 9)]) for view in views]
    holed = [without(view, pixels) for view, pixels in zip(views, specks, strict=True)]
    done = complete(holed, find_planes(holed, LOW, HIGH))
    for view, pixels in zip(done, specks, strict=True):
        assert (view.points(pixels)[:, 2] < -0.1).all()


def test_a_mirrored_image_below_a_shiny_floor_is_floor(corner):
    """The camera measures the wall's image behind the floor, as metal does it."""
    shiny = []
    for view in corner:
        # Rays that meet the floor 3 to 12 cm before the wall see the wall's image: on the ray, as far below as x tells.
        places = view.points()
        rows, columns = np.nonzero(view.measured)
        eye = view.T_world_camera[:3, 3]
        floor = (np.abs(places[:, 2]) < 2e-3) & (places[:, 0] > 0.18) & (places[:, 0] < 0.27)
        share = (0.3 - eye[0]) / (places[:, 0] - eye[0])
        floor &= np.abs(eye[1] + share * (places[:, 1] - eye[1])) < 0.24  # where the wall is
        depth = view.depth.copy()
        depth[rows[floor], columns[floor]] *= share[floor]
        shiny.append(replace(view, depth=depth))
    assert (np.concatenate([view.points() for view in shiny])[:, 2] < -0.03).sum() > 50
    done = complete(shiny, find_planes(shiny, LOW, HIGH))
    points = np.concatenate([view.points(~view.mask) for view in done])
    inside = (points[:, 0] < 0.299) & (np.abs(points[:, 1]) < 0.24)
    assert (points[inside][:, 2] > -0.02).all()
    assert ((points[:, 2] < -0.03) & (np.abs(points[:, 1]) < 0.2)).sum() == 0


def test_a_dropped_edge_is_free_as_far_as_its_nearest_neighbour(corner):
    """Around the phone's silhouette a camera measures nothing: no wedge of unknown space may reach from there to it."""
    for view in corner:
        edge = binary_dilation(view.mask, iterations=2) & ~binary_erosion(view.mask, iterations=2)
        done = bridged(without(view, edge))
        assert done.mask[edge].all()
        assert (done.depth[edge] > 0).all()
        left = np.where(view.measured & ~edge, view.depth, np.inf)
        np.testing.assert_array_equal(done.depth[edge], minimum_filter(left, size=7)[edge])
        kept = view.measured & ~edge
        np.testing.assert_array_equal(done.depth[kept], view.depth[kept])


def test_a_wide_hole_is_not_bridged(corner):
    view = corner[0]
    hole = np.zeros_like(view.mask)
    hole[80:100, 70:90] = True
    done = bridged(without(view, hole))
    assert not done.measured[84:96, 74:86].any()
