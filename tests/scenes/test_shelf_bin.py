"""A real bin of a warehouse shelf: floor, walls, back, and the tissue box from coarse masks, to a hand that pulls it out.

What is expected was read off the points. Neighbouring views differ by 4 mm, the metal floor is mostly not measured or
mirrors, and the masks spill onto the back wall.
"""

from pathlib import Path

import numpy as np
import pytest

import dexnudge as dn
from dexnudge.geometry.exact_distance import Rays
from dexnudge.scenes.free_way import free_way

FOLDERS = [parent / "shared" / "real" / "shelf_bin" for parent in Path(__file__).parents]
BIN = next((folder for folder in FOLDERS if folder.is_dir()), FOLDERS[0])
pytestmark = pytest.mark.skipif(not BIN.is_dir(), reason="the shelf's depth images are not on this machine")


@pytest.fixture(scope="module")
def scene():
    return dn.Scene.from_depth(BIN, masks="tissue_box_{}.png", motion=[-1, 0, 0], voxel=0.006)


def hit(scene, start, direction) -> float:
    """Distance [m] to the surroundings."""
    return float(
        Rays(scene.environment_mesh).first_hits(np.array([start]), np.array([direction], float), reach=2.0)[0][0]
    )


def test_floor_walls_and_back_stand_where_the_points_are(scene):
    assert 1.12 - hit(scene, [1.7, 0.03, 1.12], [0, 0, -1]) == pytest.approx(1.04, abs=0.01)
    assert hit(scene, [1.7, 0.0, 1.2], [1, 0, 0]) + 1.7 == pytest.approx(1.9, abs=0.015)
    assert hit(scene, [1.55, 0.0, 1.22], [0, 1, 0]) == pytest.approx(0.14, abs=0.015)
    assert hit(scene, [1.55, 0.0, 1.22], [0, -1, 0]) == pytest.approx(0.15, abs=0.015)
    origin = scene.environment_mesh.metadata["origin"]
    assert len(origin) == len(scene.environment_mesh.faces)
    assert np.bincount(origin, minlength=3).min() > 1000


def test_the_tissue_box_is_a_box_on_the_floor(scene):
    body = scene.object_in_world()
    np.testing.assert_allclose(body.bounds[0], [1.765, -0.045, 1.04], atol=0.012)
    np.testing.assert_allclose(body.bounds[1], [1.865, 0.077, 1.145], atol=0.012)
    front = body.triangles_center[body.face_normals[:, 0] < -0.9].mean(axis=0)
    assert front[0] == pytest.approx(1.77, abs=0.006)
    assert [support.side for support in scene.supports if support.normal[2] > 0.99]
    assert any("prism" in note for note in scene.notes)


@pytest.mark.slow
def test_it_can_be_pulled_out_by_a_hand_in_what_was_seen(scene, shadow_hand):
    assert free_way(scene).length == pytest.approx(0.1)
    samples = dn.Sampler(shadow_hand).sample(scene, num=8, seed=0)
    assert samples.success.any()
