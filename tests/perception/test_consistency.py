"""A measurement that other views contradict and none confirms is dropped; nothing else is."""

from dataclasses import replace

import numpy as np

from dexnudge.perception.depth_view import consistent

TABLE = ((-0.3, -0.25, -0.02), (0.3, 0.25, 0.0))
EYES = [(-0.45, 0.3, 0.5), (-0.5, -0.25, 0.45), (0.4, 0.0, 0.5)]


def bulged(view):
    """Ten pixels of the table measured 10 cm too near."""
    depth = view.depth.copy()
    depth[60:62, 78:83] -= 0.1
    return replace(view, depth=depth)


def test_a_bulge_of_one_view_is_dropped_and_the_rest_stays(see, made_of):
    views = see(made_of(((0.0, -0.035, 0.0), (0.15, 0.035, 0.03))), made_of(TABLE), EYES, (0, 0, 0))
    kept = consistent([bulged(views[0]), *views[1:]])
    assert (kept[0].depth[60:62, 78:83] == 0).all()
    for before, after in zip(views, kept, strict=True):
        changed = (after.depth != before.depth) & (after.depth != 0)
        assert not changed.any()
        assert (after.measured.sum() - before.measured.sum()) / before.measured.sum() > -0.01


def test_two_views_that_disagree_keep_both(see, made_of):
    views = see(made_of(((0.0, -0.035, 0.0), (0.15, 0.035, 0.03))), made_of(TABLE), EYES[:2], (0, 0, 0))
    wrong = bulged(views[0])
    np.testing.assert_array_equal(consistent([wrong, views[1]])[0].depth, wrong.depth)
