"""Where a SCARA may stand: in the annulus about the hands that it reaches, and not in the surroundings."""

import json
import sys

import numpy as np
import pytest
import trimesh
from PIL import Image

import dexnudge as dn
from dexnudge.viewer.base_picture import base_picture

TIP = 0.011 + 0.032 + 0.03  # [m] of the palm's centre over the fingertips of the boxy hand
MOUNT = trimesh.transformations.translation_matrix(
    (-0.1, 0.0, 0.0)
)  # the palm is over the wrist, so that its yaw is free


@pytest.fixture(scope="module")
def samples(boxy_hand):
    """One hand on a block that is pushed by 40 mm, a post 0.4 m away."""
    floor = trimesh.creation.box(bounds=[[-0.4, -0.4, -0.02], [0.4, 0.4, 0.0]])
    post = trimesh.creation.box(bounds=[[-0.05, 0.35, 0.0], [0.05, 0.45, 0.6]])
    pose = np.eye(4)
    pose[2, 3] = 0.01
    block = trimesh.creation.box((0.16, 0.08, 0.02))
    scene = dn.Scene(block, floor + post, pose, np.array([1.0, 0.0, 0.0]), motion_length=0.04)
    q = np.zeros((1, 13), dtype=np.float32)
    q[:, 3] = q[:, 7] = 1.0
    q[:, 2] = 0.02 + TIP + 0.0005
    return dn.Samples(scene, boxy_hand, q, dn.verify(scene, boxy_hand, q))


@pytest.fixture(scope="module")
def column_arm(scara):
    """The SCARA with a foot of 60 x 60 x 200 mm."""
    from dataclasses import replace

    foot = trimesh.creation.box(bounds=[[-0.03, -0.03, 0.0], [0.03, 0.03, 0.2]])
    return replace(scara, tree=replace(scara.tree, links={**scara.tree.links, "link0": foot}))


@pytest.fixture(scope="module")
def found(samples, column_arm):
    return dn.find_base(samples, column_arm, mount=MOUNT)


def test_places_in_the_annulus_reach_all_and_others_nothing(found):
    """The wrist, at the palm, goes from (0, 0) to (0.04, 0): the base must stay 0.1 to 0.7 m from all of that."""
    x, y = np.meshgrid(found.x, found.y)
    way = np.linspace(0.0, 0.04, 20)
    distance = np.hypot(x[..., None] - way, y[..., None])
    room = np.minimum(distance.min(axis=2) - 0.1, 0.7 - distance.max(axis=2))
    free = np.isfinite(found.share[0])
    assert (found.share[0][free & (room < -0.02)] == 0).all()
    assert (found.share[0][free & (room > 0.02)] == 1).all()
    assert (room > 0.02).sum() > 80


def test_places_in_the_surroundings_or_the_object_have_no_share(found):
    x, y = np.meshgrid(found.x, found.y)
    taken = np.isnan(found.share[0])
    post = (np.abs(x) < 0.07) & (np.abs(y - 0.4) < 0.07)
    block = (np.abs(x) < 0.105) & (np.abs(y) < 0.06)
    assert post.any()
    assert block.any()
    np.testing.assert_array_equal(taken, post | block)


def test_the_best_place_faces_the_object_and_is_where_the_map_says(found, samples, column_arm):
    best = found.best()[0]
    assert found.share[best] == 1.0
    pose = found.T_world_base
    np.testing.assert_array_equal(pose, found.pose(*best))
    np.testing.assert_allclose(pose[:3, 2], [0, 0, 1])
    towards = -pose[:2, 3] / np.linalg.norm(pose[:2, 3])
    np.testing.assert_allclose(pose[:2, 0], towards, atol=1e-6)
    np.testing.assert_allclose(pose[2, 3], 0.0, atol=1e-9)
    ranked = samples.rank(column_arm.standing_at(pose), mount=MOUNT)
    assert ranked.num_verified == 1


def test_at_a_height_that_the_lift_does_not_bridge_nothing_is_reached(samples, column_arm):
    found = dn.find_base(samples, column_arm, mount=MOUNT, heights=(-0.2, -0.6), step=0.3)
    assert np.nanmax(found.share[0]) == 1.0
    assert np.nanmax(found.share[1]) == 0.0
    assert found.best()[0][0] == 0
    np.testing.assert_allclose(found.T_world_base[2, 3], -0.2, atol=1e-9)


def test_a_map_is_saved_as_arrays_picture_and_pose(found, tmp_path):
    found.save(tmp_path / "base")
    assert sorted(path.name for path in (tmp_path / "base").iterdir()) == [
        "arm_base.json",
        "base_map.npz",
        "base_map.png",
    ]
    with np.load(tmp_path / "base" / "base_map.npz", allow_pickle=False) as arrays:
        np.testing.assert_array_equal(arrays["share"], found.share)
    content = json.loads((tmp_path / "base" / "arm_base.json").read_text())
    np.testing.assert_allclose(content["T_world_base"], found.T_world_base)
    with pytest.raises(dn.OutputError, match="exists"):
        found.save(tmp_path / "base")


def test_the_picture_is_dark_where_the_share_is_large(found, tmp_path):
    figure = base_picture(found.scene, found.x, found.y, found.heights, found.share, found.best()[0], found.arm)
    figure.savefig(tmp_path / "map.png", dpi=figure.dpi)
    pixels, axes = np.asarray(Image.open(tmp_path / "map.png")), figure.axes[0]
    step = found.x[1] - found.x[0]
    for place, low, high in (((-0.5, -0.2), 0, 100), ((0.8, 0.8), 230, 255)):
        near = found.x[np.abs(found.x - place[0]).argmin()], found.y[np.abs(found.y - place[1]).argmin()]
        column, row = axes.transData.transform(np.add(near, step / 5)).round().astype(int)
        assert low <= pixels[len(pixels) - row, column, 0] <= high


def test_without_matplotlib_a_map_has_no_picture(found, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(dn.InputError, match="needs matplotlib"):
        found.picture(tmp_path / "map.png")
    monkeypatch.setattr("dexnudge.trajectories.base_map.find_spec", lambda _: None)
    found.save(tmp_path / "base")
    assert not (tmp_path / "base" / "base_map.png").exists()


def test_where_nothing_is_reached_there_is_no_best_place(samples, column_arm, tmp_path):
    found = dn.find_base(samples, column_arm, mount=MOUNT, heights=(-0.7,), step=0.45)
    assert found.best() == []
    assert "none reaches any of 1 configurations" in repr(found)
    with pytest.raises(dn.InputError, match="reaches none of 1 configurations from any place"):
        _ = found.T_world_base
    found.save(tmp_path / "base")
    assert not (tmp_path / "base" / "arm_base.json").exists()


@pytest.mark.parametrize("options", [{"step": 0.0}, {"extent": np.inf}, {"heights": ()}, {"heights": (np.nan,)}])
def test_what_makes_no_map_is_refused(samples, scara, options):
    with pytest.raises(dn.InputError, match="expected 0 < step <= extent"):
        dn.find_base(samples, scara, mount=MOUNT, **options)


def test_samples_that_are_not_verified_are_refused(samples, boxy_hand, scara):
    q = samples.q.copy()
    q[:, 2] += 0.1
    lifted = dn.Samples(samples.scene, boxy_hand, q, dn.verify(samples.scene, boxy_hand, q))
    with pytest.raises(dn.InputError, match="none of the samples is verified"):
        dn.find_base(lifted, scara, mount=MOUNT)
