"""An object and its surroundings from depth views: what `Scene.from_depth` hands on to be understood as any other world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import SceneError, quote
from dexnudge.geometry.coarsening import coarsened_faces
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.rigid import rigid_transform
from dexnudge.perception.completion import bridged, complete, without_object
from dexnudge.perception.depth_view import DepthView, consistent
from dexnudge.perception.fusion import ASSUMED, UNSEEN, VOXEL, EmptySpace, FusedSurface, fuse
from dexnudge.perception.masked_object import masked_object
from dexnudge.perception.object_pixels import object_pixels
from dexnudge.perception.planes import Plane, find_planes
from dexnudge.perception.views import load_views
from dexnudge.scenes.files import load_pose

REACH = 0.36  # [m] around the object and its way: wherever a hand can be that touches it
WAYS = 0.10  # [m] a multiple of it is fused on all sides, so that ways of about one length are in the same world
CARVED = 0.003  # [m] around the object, and the noise of the views, that is free: what was measured there is the object
CARVED_UNSEEN = 0.008  # [m] the same where nothing was seen: no support is made of it, which is looked for within 3 mm
FINE = 0.03  # [m] around the object and its way within which the border of what was not seen stays as it was fused
COARSE_CELL = 4.0  # voxels within which that border's vertices are joined beyond: it moves by a voxel or two
SUPPORT_REACH = 0.015  # [m] from the object's lowest point to what carries it: pose errors


@dataclass(frozen=True, eq=False)
class DepthSurroundings:
    """What was made of depth views.

    Attributes:
        object_mesh: [m, object frame].
        T_world_object: (4, 4).
        environment_mesh: fused surface [m, world]; `metadata["origin"]` says of each face what it is: 0 seen, 1 assumed,
            2 the border of what was not seen; `metadata["notes"]` what was assumed, a sentence each.
        noise: of the fused surface that carries the object, root mean square [m]; None where it is no plane.
    """

    object_mesh: trimesh.Trimesh
    T_world_object: Float[np.ndarray, "4 4"]
    environment_mesh: trimesh.Trimesh
    noise: float | None


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
    support: Plane | None = None
    if (object_mesh is None) != (object_pose is None):
        given, missing = ("object_pose", "object") if object_mesh is None else ("object", "object_pose")
        raise SceneError(
            f"`{given}` is given without `{missing}`; expected both, or neither for an object that is known from its masks"
        )
    if unseen not in ("solid", "free"):
        raise SceneError(f"`unseen` is {quote(unseen)}; expected 'solid' or 'free'")
    views = consistent(load_views(views, masks=masks, view_points=view_points))
    if object_mesh is None or object_pose is None:
        found = masked_object(views)
        mesh, T_world_object = found.mesh, found.T_world_object
        support = found.support
        notes += found.assumed
    else:
        mesh = object_mesh
        T_world_object = load_pose(object_pose) if isinstance(object_pose, str | Path) else rigid_transform(object_pose)
    body = mesh.copy().apply_transform(T_world_object)
    own = object_pixels(views, body)
    low, high = body.bounds
    way_low, way_high = np.minimum(low, low + way), np.maximum(high, high + way)
    around = REACH + np.array([1.0, 1.0, 0.0]) * WAYS * np.ceil(np.linalg.norm(way) / WAYS - 1e-9)
    low, high = body.bounds[0] - around, body.bounds[1] + around
    shown = [replace(view, mask=pixels) for view, pixels in zip(views, own, strict=True)]
    planes = find_planes([without_object(view) for view in shown], low, high)
    support = support or _support(planes, float(body.bounds[0, 2]))
    completed = [bridged(view) for view in complete(shown, planes)]
    fused = fuse(
        completed,
        low,
        high,
        voxel=VOXEL if voxel is None else voxel,
        unseen=unseen,
        empty=_own_space(body, support),
    )
    notes += _notes(fused, unseen, support)
    environment, origin = fused.mesh, fused.origin
    if unseen == "solid":  # else the border is the back of what was seen, two voxels behind its front
        cell = COARSE_CELL * fused.voxel
        environment, kept = coarsened_faces(environment, origin == UNSEEN, way_low, way_high, reach=FINE, cell=cell)
        origin = origin[kept]
    by_origin = np.argsort(origin, kind="stable")  # so that a file tells them apart by three numbers
    environment.faces = np.asarray(environment.faces)[by_origin]
    environment.metadata["origin"] = origin[by_origin]
    environment.metadata["notes"] = notes
    noise = support.noise / np.sqrt(len(views)) if support else None  # of a mean over the views
    return DepthSurroundings(mesh, T_world_object, environment, noise)


def _own_space(body: trimesh.Trimesh, support: Plane | None) -> EmptySpace:
    """Return the object's own volume and a little more, above what carries it: more where views scatter more."""
    exact, bottom = ExactDistance(body), float(body.bounds[0, 2])
    carved = CARVED + (support.noise if support else 0.0)

    def distance(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        below = -support.heights(points) if support else bottom - points[:, 2]
        return np.maximum(exact(points).distance - carved, below)

    unseen = max(0.0, CARVED_UNSEEN - carved)
    return EmptySpace(body.bounds[0] - carved, body.bounds[1] + carved, distance, unseen_margin=unseen)


def _support(planes: Sequence[Plane], bottom: float) -> Plane | None:
    """Return the level plane nearest to the object's lowest point, if one is near."""
    near = [plane for plane in planes if plane.level and abs(plane.offset / plane.normal[2] - bottom) < SUPPORT_REACH]
    return min(near, key=lambda plane: abs(plane.offset / plane.normal[2] - bottom), default=None)


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
