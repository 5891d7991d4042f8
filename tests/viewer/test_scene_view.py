"""What pictures and pages of a scene show before anything is sampled."""

import numpy as np
import pytest
import trimesh

import dexnudge as dn
from dexnudge.scenes.boxes import box
from dexnudge.scenes.free_way import free_way
from dexnudge.viewer.scene_view import scene_picture, scene_view

TABLE = box((-0.3, -0.2, -0.04), (0.3, 0.2, 0.0))
RIB = box((0.116, -0.1, -0.01), (0.126, 0.1, 0.006))


def scene_of(environment):
    pose = trimesh.transformations.translation_matrix((0, 0, 0.004))
    return dn.Scene(trimesh.creation.box((0.15, 0.07, 0.008)), environment, pose, np.array([1.0, 0.0, 0.0]))


def test_what_carries_the_object_is_outlined_and_the_free_way_to_scale():
    scene = scene_of(TABLE)
    view = scene_view(scene, free_way(scene))
    (ring,) = view.with_role("support")
    np.testing.assert_allclose(ring.mesh.extents, [0.16, 0.08, 0.0], atol=1e-3)
    assert np.ptp(view.arrow().mesh.vertices[:, 0]) == pytest.approx(0.10)
    assert not view.with_role("obstacle")


def test_the_arrow_ends_at_the_obstacle():
    scene = scene_of(trimesh.util.concatenate([TABLE, RIB]))
    view = scene_view(scene, free_way(scene))
    assert np.ptp(view.arrow().mesh.vertices[:, 0]) == pytest.approx(0.041, abs=1e-4)
    (ball,) = view.with_role("obstacle")
    assert ball.T_world_part[0, 3] == pytest.approx(0.116, abs=1e-4)


def test_surroundings_are_told_apart_by_origin_and_unseen_ones_are_looked_through():
    cover = box((-0.1, -0.06, 0.02), (0.1, 0.06, 0.03))
    surroundings = trimesh.util.concatenate([TABLE, cover])
    surroundings.metadata["origin"] = np.repeat([0, 2], 12)
    seen = scene_view(scene_of(surroundings), None)
    assert [len(part.mesh.faces) for part in seen.with_role("environment", "unseen")] == [12, 12]
    assert not len(seen.arrow().mesh.faces)  # where the way is not known
    scene = scene_of(surroundings)
    picture = scene_picture(scene_view(scene, free_way(scene)), size=(120, 90)).astype(float)
    # pixels of the object's orange: 138 through the cover, 50 beside one that is solid
    assert (picture[..., 0] - picture[..., 2] > 60).sum() > 100


def test_a_large_scan_is_shown_near_the_object_alone(monkeypatch):
    monkeypatch.setattr("dexnudge.viewer.visual_scene.LARGE", 20)
    far = TABLE.copy().apply_translation((5.0, 0.0, 0.0))
    view = scene_view(scene_of(trimesh.util.concatenate([TABLE, far])), None)
    assert view.vertices("environment")[:, 0].max() < 2.0
    assert len(view.mesh("environment").faces) == 12
