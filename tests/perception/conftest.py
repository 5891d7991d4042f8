"""Scenes of boxes, and what a small depth camera sees of them."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from dexnudge.perception.depth_view import DepthView
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.depth_camera import DepthCamera, DepthRenderer, looking_at


def boxes(*bounds) -> trimesh.Trimesh:
    return trimesh.util.concatenate([trimesh.creation.box(bounds=np.array(each)) for each in bounds])


def look_at(position, target) -> np.ndarray:
    """T_world_camera of a level camera at `position` that looks at `target` [m]."""
    forward = np.subtract(target, position) / np.linalg.norm(np.subtract(target, position))
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, position], axis=1)
    return pose


def seen_boxes(
    boxes, position, target, *, width=160, height=120, focal=150.0, noise=0.0, seed=0, objects=()
) -> DepthView:
    """Return what a camera sees of boxes (low, high) [m], exactly; those numbered in `objects` are the mask."""
    pose = look_at(position, target)
    u, v = np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2)
    rays = np.stack([u / focal, v / focal, np.ones_like(u)], axis=-1) @ pose[:3, :3].T  # one metre of depth each
    depth, which = np.full(u.shape, np.inf), np.full(u.shape, -1)
    for number, (low, high) in enumerate(boxes):
        with np.errstate(divide="ignore"):
            first, second = (np.subtract(side, position) / rays for side in (low, high))
        near, far = np.minimum(first, second).max(axis=-1), np.maximum(first, second).min(axis=-1)
        hit = (near > 0) & (near <= far) & (near < depth)
        depth[hit], which[hit] = near[hit], number
    depth[np.isfinite(depth)] += noise * np.random.default_rng(seed).normal(size=np.isfinite(depth).sum())
    depth[~np.isfinite(depth)] = 0.0
    mask = np.isin(which, list(objects)) if objects else None
    return DepthView(depth, focal, focal, (width - 1) / 2, (height - 1) / 2, pose, mask)


@pytest.fixture(scope="session")
def see() -> Callable[..., list[DepthView]]:
    """Views of an object (a mesh in the world) in its surroundings from several eyes, all towards one target."""

    def views(thing, surroundings, eyes, target, *, noise=0.0, seed=0, width=160, height=120, focal=150.0):
        camera = DepthCamera(width=width, height=height, focal=focal, noise=noise, unit=0.0001 if not noise else 0.001)
        scene = Scene(thing, surroundings, np.eye(4), np.array([1.0, 0.0, 0.0]))
        renderer, generator = DepthRenderer(scene, camera), np.random.default_rng(seed)
        return [renderer.view(looking_at(np.array(target, float), np.array(eye, float)), generator) for eye in eyes]

    return views


@pytest.fixture(scope="session")
def made_of() -> Callable[..., trimesh.Trimesh]:
    """A mesh of boxes, each given by its bounds."""
    return boxes


@pytest.fixture(scope="session")
def corner(see) -> list[DepthView]:
    """A phone of 150 x 70 x 30 mm on a table of 600 x 500 mm at z = 0, before a wall at x = 0.3."""
    table, wall = ((-0.3, -0.25, -0.02), (0.3, 0.25, 0.0)), ((0.3, -0.25, -0.02), (0.32, 0.25, 0.3))
    phone = boxes(((0.0, -0.035, 0.0), (0.15, 0.035, 0.03)))
    return see(phone, boxes(table, wall), [(-0.45, 0.3, 0.5), (-0.5, -0.25, 0.45)], (0.1, 0, 0))


@pytest.fixture(scope="session")
def camera() -> Callable[..., DepthView]:
    """An exact camera, written without a renderer, that sees boxes which stand along the axes."""
    return seen_boxes
