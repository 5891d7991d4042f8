"""Rendered depth against closed forms, and the noise of the camera against the formulas that it is taken from."""

import numpy as np
import pytest
import trimesh

from dexnudge.perception.views import load_views, save_views
from dexnudge.scenes.boxes import box
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.depth_camera import (
    DISPARITY_STEP,
    DepthCamera,
    DepthRenderer,
    SeenSurface,
    axial_noise,
    camera_poses,
    depth_views,
    lateral_noise,
    looking_at,
    measured_depth,
)

SMALL = DepthCamera(width=160, height=120, focal=146.0)
FLAWLESS = DepthCamera(width=160, height=120, focal=146.0, noise=0.0)
ABOVE = np.array([0.0, 1e-6, 0.7])  # [m] not straight above: a camera there has no upright pose


@pytest.fixture(scope="module")
def flat_scene():
    """A block of 120 x 60 x 20 mm in the middle of a table whose top is z = 0."""
    pose = np.eye(4)
    pose[2, 3] = 0.01
    table = box((-0.6, -0.4, -0.04), (0.6, 0.4, 0.0))
    return Scene(trimesh.creation.box((0.12, 0.06, 0.02)), table, pose, np.array([1.0, 0.0, 0.0]))


def facing_plane(depth: float) -> SeenSurface:
    """What a camera sees of a wall that it faces."""
    shape = (SMALL.height, SMALL.width)
    normal = np.broadcast_to([0.0, 0.0, -1.0], (*shape, 3))
    every = np.ones(shape, dtype=bool)
    return SeenSurface(np.full(shape, depth), normal, np.zeros(shape), ~every, every)


def test_depth_is_that_of_the_planes(flat_scene):
    position = np.array([0.1, -0.4, 0.5])
    pose = looking_at(np.zeros(3), position)
    seen = DepthRenderer(flat_scene, SMALL, room=False).render(pose)
    directions = SMALL.directions() @ pose[:3, :3].T
    for pixels, height in ((seen.on_object & (seen.normal @ pose[2, :3] > 0.99), 0.02), (~seen.on_object, 0.0)):
        top = pixels & (seen.depth > 0) & (seen.normal @ pose[2, :3] > 0.99)
        assert top.sum() > 100
        np.testing.assert_allclose(seen.depth[top], ((height - position[2]) / directions[..., 2])[top], atol=1e-5)
        cosine = -directions[top][:, 2] / np.linalg.norm(directions[top], axis=1)
        np.testing.assert_allclose(np.cos(seen.incidence[top]), cosine, atol=1e-5)


@pytest.mark.parametrize("depth", [0.5, 1.0, 2.0])
def test_noise_of_a_wall_grows_as_measured_by_nguyen(depth):
    found = measured_depth(facing_plane(depth), SMALL, np.random.default_rng(0))
    expected = 0.0012 + 0.0019 * (depth - 0.4) ** 2
    assert (found > 0).all()
    assert found.std() == pytest.approx(expected, rel=0.06)
    assert found.mean() == pytest.approx(depth, abs=4e-4)


def test_formulas_at_steep_angles():
    angles = np.radians([0.0, 59.0, 70.0, 79.0])
    axial, lateral = axial_noise(np.full(4, 1.0), angles), lateral_noise(angles)
    assert axial[0] == axial[1] == pytest.approx(0.0012 + 0.0019 * 0.36)
    assert axial[2] - axial[0] == pytest.approx(1e-4 * angles[2] ** 2 / (np.pi / 2 - angles[2]) ** 2)
    assert axial[3] > axial[2]
    assert lateral[0] == pytest.approx(0.8)
    assert lateral[2] == pytest.approx(0.8 + 0.035 * angles[2] / (np.pi / 2 - angles[2]))


def test_depths_stand_a_step_of_disparity_apart():
    seen = facing_plane(1.0)
    ramp = np.linspace(1.9, 2.1, SMALL.width)
    seen = SeenSurface(np.tile(ramp, (SMALL.height, 1)), seen.normal, seen.incidence, seen.on_object, seen.lit)
    depths = np.unique(measured_depth(seen, FLAWLESS, np.random.default_rng(0)))
    assert np.allclose(np.diff(depths), DISPARITY_STEP * 2.0**2, atol=2.3e-3)  # 11.4 mm, to a millimetre at both ends
    np.testing.assert_allclose(depths, np.round(depths, 3), atol=1e-9)
    np.testing.assert_allclose(1 / depths / DISPARITY_STEP, np.rint(1 / depths / DISPARITY_STEP), atol=0.05)


def test_nothing_is_measured_at_edges_in_shadow_and_at_grazing_angles(flat_scene):
    wall = box((-0.05, 0.1, 0.0), (0.05, 0.12, 0.2))
    scene = Scene(
        flat_scene.object_mesh,
        trimesh.util.concatenate([flat_scene.environment_mesh, wall]),
        flat_scene.T_world_object,
        flat_scene.motion,
    )
    renderer = DepthRenderer(scene, FLAWLESS, room=False)
    seen = renderer.render(looking_at(np.zeros(3), np.array([0.0, -0.5, 0.4])))
    found = measured_depth(seen, FLAWLESS, np.random.default_rng(0))
    shadow = (seen.depth > 0) & ~seen.lit
    assert shadow.sum() > 30
    assert not found[~seen.lit].any()
    jump = np.abs(np.diff(seen.depth, axis=1)) > 0.05
    assert jump.sum() > 5
    assert not found[:, :-1][jump].any()
    assert not found[:, 1:][jump].any()
    assert (found[seen.lit & (seen.depth > 0)] > 0).mean() > 0.9  # the rest is measured
    flat = renderer.render(looking_at(np.zeros(3), np.array([0.0, -0.55, 0.04])))
    grazing = ~flat.on_object & (flat.incidence > np.radians(80.0))
    assert grazing.sum() > 100
    assert not measured_depth(flat, FLAWLESS, np.random.default_rng(0))[grazing].any()


def test_what_lies_behind_the_scene_is_measured_too(flat_scene):
    """Without it nobody could tell that the space beside a table is free."""
    pose = looking_at(np.zeros(3), np.array([0.0, -0.6, 0.3]))
    bare, in_room = (DepthRenderer(flat_scene, FLAWLESS, room=room).render(pose) for room in (False, True))
    assert (bare.depth == 0).mean() > 0.2
    assert (in_room.depth > 0).all()
    np.testing.assert_allclose(in_room.depth[bare.depth > 0], bare.depth[bare.depth > 0], atol=1e-6)
    behind = in_room.depth[bare.depth == 0]
    assert behind.min() > 1.0


def test_the_mask_is_the_object(flat_scene):
    view = DepthRenderer(flat_scene, FLAWLESS).view(looking_at(np.zeros(3), ABOVE), np.random.default_rng(0))
    points = view.points(view.mask)
    assert points[:, 2] == pytest.approx(
        np.full(len(points), 0.02), abs=1.5e-3
    )  # half a step of disparity, and rounding
    size = np.ptp(points[:, :2], axis=0)
    assert size == pytest.approx([0.12, 0.06], abs=0.7 / 146 * 2.5)  # within a pixel at each end


@pytest.mark.parametrize("family", ["layers", "shelf"])
def test_cameras_stand_in_front_of_the_opening(family):
    scene = build_scene(family, "phone", seed=3)
    poses = camera_poses(scene, num=3)
    centre = scene.object_in_world().bounds.mean(axis=0)
    assert len(poses) == 3
    for pose in poses:
        away = pose[:3, 3] - centre
        assert 0.5 <= np.linalg.norm(away) <= 0.8
        assert away @ scene.motion > 0.3
        assert away[2] > 0
        np.testing.assert_allclose(pose[:3, 2], -away / np.linalg.norm(away), atol=1e-9)
        np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-9)
        assert np.linalg.det(pose[:3, :3]) > 0
        assert pose[2, 1] < 0  # y is down
    assert max(np.linalg.norm(a[:3, 3] - b[:3, 3]) for a in poses for b in poses) > 0.2


def test_views_are_read_back_as_they_were_written(flat_scene, tmp_path):
    views = depth_views(flat_scene, np.random.default_rng(0), num=2, camera=SMALL)
    read = load_views(save_views(views, tmp_path / "views").parent)
    assert len(read) == 2
    for one, other in zip(views, read, strict=True):
        np.testing.assert_allclose(other.depth, one.depth, atol=1e-6)
        assert (other.mask == one.mask).all()
        np.testing.assert_allclose(other.T_world_camera, one.T_world_camera, atol=1e-12)
        assert (other.fx, other.cx, other.cy) == (one.fx, one.cx, one.cy)


def test_the_same_seed_gives_the_same_views(flat_scene):
    one, same, other = (
        depth_views(flat_scene, np.random.default_rng(seed), num=1, camera=SMALL)[0] for seed in (1, 1, 2)
    )
    assert (one.depth == same.depth).all()
    assert (one.depth != other.depth).any()
