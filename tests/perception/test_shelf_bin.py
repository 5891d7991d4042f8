"""A real bin, seen by a camera on a robot's wrist, where the measurements are at hand."""

from pathlib import Path

import numpy as np
import pytest

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.perception.fusion import SEEN, UNSEEN, fuse
from dexnudge.perception.views import load_views

SHELF = Path(__file__).parents[3] / "shared" / "real" / "shelf_bin"
VIEWS_DIFFER = 0.004  # [m] neighbouring views, in the median: the robot's kinematics
LOW, HIGH = np.array([1.40, -0.22, 1.0]), np.array([1.95, 0.22, 1.32])

pytestmark = pytest.mark.skipif(not SHELF.is_dir(), reason="the measurements of the bin are not here")


@pytest.fixture(scope="module")
def fused():
    return fuse(load_views(SHELF), LOW, HIGH)


def test_the_masks_of_each_object_are_read():
    counts = {
        name: [int(view.mask.sum()) for view in load_views(SHELF, masks=name + "_{}.png")]
        for name in ("book_tall", "tissue_box")
    }
    assert counts["book_tall"][1] == 0  # hidden from this view
    assert min(counts["tissue_box"]) > 2000


@pytest.mark.parametrize(
    ("axis", "low", "high"),
    [
        (0, (1.86, -0.08, 1.15), (1.95, 0.08, 1.25)),  # back wall
        (0, (1.72, -0.02, 1.06), (1.82, 0.05, 1.12)),  # front of the tissue box
        (1, (1.52, 0.13, 1.06), (1.60, 0.17, 1.16)),  # a side wall
    ],
)
def test_surfaces_lie_amid_what_the_views_measured_of_them(fused, axis, low, high):
    seen = fused.mesh.vertices[np.unique(fused.mesh.faces[fused.origin == SEEN])]
    measured = np.concatenate([view.points() for view in load_views(SHELF)])
    seen, measured = (part[((part > low) & (part < high)).all(axis=1)][:, axis] for part in (seen, measured))
    assert len(seen) > 100
    assert np.median(seen) == pytest.approx(np.median(measured), abs=VIEWS_DIFFER)
    assert np.median(np.abs(seen - np.median(seen))) < VIEWS_DIFFER


def test_the_room_of_the_bin_is_free_and_what_lies_behind_its_walls_is_not(fused):
    places = np.array([[1.65, 0.0, 1.15], [1.85, -0.08, 1.2], [1.94, 0.0, 1.2], [1.82, 0.02, 1.08], [1.6, 0.2, 1.1]])
    assert (ExactDistance(fused.mesh)(places).distance > 0).tolist() == [True, True, False, False, False]
    assert fused.unseen > fused.free / 2 > fused.seen
    assert (fused.origin == UNSEEN).any()
