"""Which pixels of depth views show an object whose shape and place are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import trimesh
from jaxtyping import Bool
from PIL import Image, ImageDraw
from scipy.ndimage import binary_dilation

from dexnudge.errors import SceneError
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.perception.depth_view import DepthView, votes

OWN = 0.015  # [m] from the object's surface within which a measured point is the object's: pose error and noise
OWN_MASKED = 0.04  # [m] the same for a masked pixel
STRAY = 0.06  # [m] before the object within which a measurement may be the object's, badly matched
BEFORE = 0.008  # [m] before the object, from where it is seen through that place
BEHIND = 0.03  # [m] a point farther than this from the object, on a ray through it, was seen through its place
LEAST_PIXELS = 30  # that show the object, of all views
SEEN_THROUGH = 0.7  # of the object's measured pixels: its pose is wrong, or the object is not there
OUT_OF_REACH = 5.0  # [m] no robot's object lies farther from its frame's origin
UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254}  # [m] that a pose may be in by mistake


def object_pixels(views: Sequence[DepthView], body: trimesh.Trimesh) -> list[Bool[np.ndarray, "height width"]]:
    """Return which pixels of each view show an object [m, world]: measured on it, or not measured where it is in sight.

    A measurement before the object is taken for the object too where another view saw the object through its place.

    Raises:
        SceneError: too few pixels show the object, or most look through its place; the message says what may be wrong.
    """
    distance = ExactDistance(body)
    outlines = [_silhouette(view, body) for view in views]
    pixels, measured, through = [], 0, 0
    for view, outline in zip(views, outlines, strict=True):
        near = binary_dilation(outline, iterations=3)  # an object's edges are blurred
        asked = view.measured & (near if view.mask is None else near | view.mask)
        limit = np.full(asked.shape, OWN) if view.mask is None else np.where(view.mask, OWN_MASKED, OWN)
        away = np.full(asked.shape, np.inf)
        away[asked] = distance(view.points(asked)).distance
        pixels.append(outline & ~view.measured | asked & (away < limit))
        # Farther along the ray than the object's middle: the object did not stop it.
        beyond = view.depth > float(view.project(body.bounds.mean(axis=0)[None])[0, 2])
        measured += int((outline & view.measured).sum())
        through += int((outline & view.measured & (away > BEHIND) & beyond).sum())
    on_object = sum(int((own & view.measured).sum()) for own, view in zip(pixels, views, strict=True))
    if on_object < LEAST_PIXELS or through > SEEN_THROUGH * measured:
        raise SceneError(_not_seen(views, body, on_object, measured, through))
    shown = [_only(view, own) for view, own in zip(views, pixels, strict=True)]
    for index, (view, outline) in enumerate(zip(views, outlines, strict=True)):
        others = [other for other in shown[:index] + shown[index + 1 :] if other is not None]
        open_pixels = outline & view.measured & ~pixels[index]
        points = view.points(open_pixels)
        if len(points) and others:
            stray = (distance(points).distance < STRAY) & (votes(points, others, beyond=BEFORE)[1] > 0)
            pixels[index][open_pixels] = stray
    return pixels


def _only(view: DepthView, pixels: Bool[np.ndarray, "height width"]) -> DepthView | None:
    """Return the view with these pixels alone; None where they measured nothing."""
    kept = np.where(pixels, view.depth, 0.0)
    return replace(view, depth=kept) if kept.any() else None


def _not_seen(views: Sequence[DepthView], body: trimesh.Trimesh, on_object: int, measured: int, through: int) -> str:
    """Return why the views do not show the object, and what may be wrong."""
    x, y, z = body.bounds.mean(axis=0)
    place = f"({x:.3f}, {y:.3f}, {z:.3f}) m in the world"
    expected = f"expected at least {LEAST_PIXELS} pixels that show it"
    sight = sum(bool(view.sees(np.array([[x, y, z]]))[0]) for view in views)
    for unit, metres in UNITS.items():
        moved = np.array([[x, y, z]]) * metres
        far = max(abs(x), abs(y), abs(z)) > OUT_OF_REACH
        if not sight and far and any(view.sees(moved)[0] for view in views):
            return f"the views do not see the object at {place}; {expected}; is the pose in {unit}? give it in metres"
    if not sight:
        points = np.concatenate([view.points() for view in views])
        low, high = np.percentile(points, [2, 98], axis=0).round(2)
        return (
            f"none of the {len(views)} views looks at the object at {place}; what they measured lies between {low.tolist()} "
            f"and {high.tolist()} m; {expected}; are `object_pose` and `T_world_camera` in one frame, in metres?"
        )
    if through > SEEN_THROUGH * measured > 0:
        return (
            f"the views see through the object at {place}: {through} of the {measured} pixels measured there lie more than "
            f"{1e3 * BEHIND:.0f} mm behind it; {expected}; is `object_pose` in the frame of `T_world_camera`, and the "
            "object there?"
        )
    return (
        f"{on_object} pixels show the object at {place}; {expected}; is it hidden, or not measured (black, transparent, "
        "shiny), or is `object_pose` in another frame than `T_world_camera`?"
    )


def _silhouette(view: DepthView, body: trimesh.Trimesh) -> Bool[np.ndarray, "height width"]:
    """Return the pixels whose rays meet the object."""
    image = Image.new("1", (view.width, view.height))
    places = view.project(np.asarray(body.vertices))
    in_front = (places[:, 2] > 0.01)[body.faces].all(axis=1)
    draw = ImageDraw.Draw(image)
    for corners in places[body.faces[in_front], :2]:
        draw.polygon([(float(u), float(v)) for u, v in corners.clip(-1e5, 1e5)], fill=1, outline=1)
    return np.array(image)
