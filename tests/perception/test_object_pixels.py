"""Pixels that show an object: on it, unmeasured in its outline, or strays before it that another view saw through."""

from dataclasses import replace

import numpy as np
import pytest

from dexnudge.errors import SceneError
from dexnudge.perception.object_pixels import object_pixels

PHONE = ((0.0, -0.035, 0.0), (0.15, 0.035, 0.03))


def test_they_are_those_of_the_rendered_mask(corner, made_of):
    for view, pixels in zip(corner, object_pixels(corner, made_of(PHONE)), strict=True):
        assert (pixels & view.mask).sum() > 0.97 * view.mask.sum()
        wrong = pixels & ~view.mask & view.measured
        assert (view.points(wrong)[:, 2] < 0.03).all()  # of the table, within the tolerance of the pose
        assert wrong.sum() < 0.5 * view.mask.sum()


def test_a_bulge_before_the_object_is_the_objects_if_another_view_saw_through_it(corner, made_of):
    view = corner[0]
    row, column = np.median(np.argwhere(view.mask & view.measured), axis=0).astype(int)
    middle = (slice(row - 2, row + 2), slice(column - 2, column + 2))
    depth = view.depth.copy()
    depth[middle] -= 0.04
    bulged = replace(view, depth=depth, mask=None)
    assert object_pixels([bulged, view], made_of(PHONE))[0][middle].all()
    assert not object_pixels([bulged], made_of(PHONE))[0][middle].any()


def test_an_object_that_is_not_there_is_refused(corner, made_of):
    with pytest.raises(SceneError, match="see through the object"):
        object_pixels(corner, made_of(((-0.2, -0.1, 0.1), (-0.1, 0.0, 0.2))))
    with pytest.raises(SceneError, match="looks at the object"):
        object_pixels(corner, made_of(((2.0, 0.0, 0.0), (2.1, 0.1, 0.1))))
