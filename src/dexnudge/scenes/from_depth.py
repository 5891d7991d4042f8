"""An object and its surroundings from depth views: what `Scene.from_depth` hands on to be understood as any other world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from PIL import Image, ImageDraw
from scipy.ndimage import binary_dilation

from dexnudge.errors import SceneError, quote
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.perception.completion import complete
from dexnudge.perception.consistency import consistent, votes
from dexnudge.perception.depth_view import DepthView
from dexnudge.perception.fusion import ASSUMED, UNSEEN, VOXEL, EmptySpace, FusedSurface, fuse
from dexnudge.perception.masked_object import masked_object
from dexnudge.perception.planes import Plane, find_planes
from dexnudge.perception.views import load_views
from dexnudge.scenes.poses import load_pose, rigid_transform

UNSEEN_IS = ("solid", "free")
REACH = 0.36  # [m] around the object and its way: wherever a hand can be that touches it
OWN = 0.015  # [m] from the object's surface within which a measured point is the object's: pose error and noise
OWN_MASKED = 0.04  # [m] the same for a masked pixel
STRAY = 0.06  # [m] the same before the object, for a place that another view saw through
BEHIND = 0.03  # [m] a point farther than this from the object, on a ray through it, was seen through its place
CARVED = 0.003  # [m] around the object that is free of what was not seen, more than a support's distance of 1 mm
SUPPORT_REACH = 0.015  # [m] from the object's lowest point to what carries it: pose errors
LEAST_PIXELS = 30  # that show the object, of all views
SEEN_THROUGH = 0.7  # of the object's measured pixels: its pose is wrong, or the object is not there
OUT_OF_REACH = 5.0  # [m] no robot's object lies farther from its frame's origin
UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254}  # [m] that a pose may be in by mistake


@dataclass(frozen=True, eq=False)
class DepthSurroundings:
    """What was made of depth views.

    Attributes:
        object_mesh: [m, object frame].
        T_world_object: (4, 4).
        environment_mesh: fused surface [m, world]; `metadata["origin"]` says of each face what it is: 0 seen, 1 assumed,
            2 the border of what was not seen.
        noise: of the plane that carries the object, root mean square [m]; None where none was found.
        notes: what was assumed, a sentence each.
    """

    object_mesh: trimesh.Trimesh
    T_world_object: Float[np.ndarray, "4 4"]
    environment_mesh: trimesh.Trimesh
    noise: float | None
    notes: tuple[str, ...]


def scene_from_depth(
    views: str | Path | Sequence[DepthView],
    *,
    object_mesh: trimesh.Trimesh | None,
    object_pose: str | Path | Float[np.ndarray, "4 4"] | None,
    way: Float[np.ndarray, "3"],
    masks: str | None,
    view_points: Any,
    unseen: str,
    voxel: float | None,
) -> DepthSurroundings:
    """Return object and surroundings: planes found, holes completed, views fused, the object's own space emptied.

    Args:
        views: see `load_views`.
        object_mesh: [m, object frame]; None where masks are all that is known of it.
        object_pose: T_world_object or a file with it; with `object_mesh`.
        way: motion times its length [m].
        masks: see `load_views`.
        view_points: see `load_views`.
        unseen: what space counts as that no view looked into.
        voxel: edge [m]; 4 mm if None.

    Raises:
        SceneError: the views do not see the object, or its masks cannot be used.
    """
    notes: list[str] = []
    if (object_mesh is None) != (object_pose is None):
        given, missing = ("object_pose", "object") if object_mesh is None else ("object", "object_pose")
        raise SceneError(
            f"`{given}` is given without `{missing}`; expected both, or neither for an object that is known from its masks"
        )
    if unseen not in UNSEEN_IS:
        raise SceneError(f"`unseen` is {quote(unseen)}; expected 'solid' or 'free'")
    views = consistent(load_views(views, masks=masks, view_points=view_points))
    if object_mesh is None or object_pose is None:
        found = masked_object(views)
        mesh, T_world_object = found.mesh, found.T_world_object
        notes += found.assumed
    else:
        mesh = object_mesh
        T_world_object = load_pose(object_pose) if isinstance(object_pose, str | Path) else rigid_transform(object_pose)
    body = mesh.copy()
    body.apply_transform(T_world_object)
    own = _object_pixels(views, body)
    low, high = body.bounds
    low, high = np.minimum(low, low + way) - REACH, np.maximum(high, high + way) + REACH
    shown = [replace(view, mask=pixels) for view, pixels in zip(views, own, strict=True)]
    planes = find_planes([_bare(view) for view in shown], low, high)
    support = _support(planes, float(body.bounds[0, 2]))
    completed = complete(shown, planes)
    fused = fuse(
        completed,
        low,
        high,
        voxel=VOXEL if voxel is None else voxel,
        unseen=unseen,  # type: ignore[arg-type]  # checked above
        empty=_own_space(body, support),
    )
    notes += _notes(fused, unseen, support)
    environment = fused.mesh
    environment.metadata["origin"] = fused.origin
    environment.metadata["notes"] = notes
    return DepthSurroundings(mesh, T_world_object, environment, support.noise if support else None, tuple(notes))


def _own_space(body: trimesh.Trimesh, support: Plane | None) -> EmptySpace:
    """Return the object's own volume and a little more, above what carries it."""
    exact, bottom = ExactDistance(body), float(body.bounds[0, 2])

    def distance(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        below = -support.heights(points) if support else bottom - points[:, 2]
        return np.maximum(exact(points).distance - CARVED, below)

    return EmptySpace(body.bounds[0] - CARVED, body.bounds[1] + CARVED, distance)


def _bare(view: DepthView) -> DepthView:
    """Return the view without the object."""
    assert view.mask is not None
    rest = view.measured & ~view.mask
    return replace(view, depth=np.where(rest, view.depth, 0.0)) if rest.any() else view


def _support(planes: Sequence[Plane], bottom: float) -> Plane | None:
    """Return the level plane nearest to the object's lowest point, if one is near."""
    near = [plane for plane in planes if plane.level and abs(plane.offset / plane.normal[2] - bottom) < SUPPORT_REACH]
    return min(near, key=lambda plane: abs(plane.offset / plane.normal[2] - bottom), default=None)


def _object_pixels(views: Sequence[DepthView], body: trimesh.Trimesh) -> list[Bool[np.ndarray, "height width"]]:
    """Return which pixels show the object: measured on it, or not measured where it is in sight."""
    distance = ExactDistance(body)
    pixels, on_object, measured, through, nearest = [], 0, 0, 0, np.inf
    for view in views:
        outline = _silhouette(view, body)
        inside = outline & view.measured
        near = _dilated(outline) if view.mask is None else _dilated(outline) | view.mask
        asked = near & view.measured
        shown = outline & ~view.measured
        if asked.any():
            away = distance(view.points(asked)).distance
            limit = np.full(asked.shape, OWN)
            if view.mask is not None:
                limit[view.mask] = OWN_MASKED
            others = [other for other in views if other is not view]
            disputed = (away < STRAY) & outline[asked] & (votes(view.points(asked), others)[1] > 0)
            shown[asked] = (away < limit[asked]) | disputed
            on_object += int((inside & shown).sum())
            measured += int(inside.sum())
            # Farther along the ray than the object's middle: the object did not stop it.
            beyond = view.depth > float(view.project(body.bounds.mean(axis=0)[None])[0, 2])
            lost = np.zeros(asked.shape, dtype=bool)
            lost[asked] = away > BEHIND
            through += int((inside & lost & beyond).sum())
            nearest = min(nearest, float(np.abs(away).min()))
        pixels.append(shown)
    if on_object < LEAST_PIXELS or through > SEEN_THROUGH * measured:
        raise SceneError(_not_seen(views, body, on_object, measured, through))
    return pixels


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


def _dilated(pixels: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    """Return pixels and their neighbours up to three away: an object's edges are blurred."""
    return np.asarray(binary_dilation(pixels, iterations=3))


def _notes(fused: FusedSurface, unseen: str, support: Plane | None) -> list[str]:
    area = fused.mesh.area_faces
    shares = [float(area[fused.origin == kind].sum() / area.sum()) for kind in (ASSUMED, UNSEEN)]
    fusion = (
        f"fused from depth in voxels of {1e3 * fused.voxel:.1f} mm: {shares[0]:.0%} of the surface is assumed (planes "
        f"completed), {shares[1]:.0%} bounds space that no view saw, which counts as {unseen}"
    )
    notes = [fusion]
    if support is None:
        notes.append("no plane was found below the object: what carries it is what was measured there")
    return notes
