"""The hole that a scan has where the object lay while it was made, closed by the plane around it."""

from __future__ import annotations

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import ConvexHull

from dexnudge.geometry.exact_distance import Rays
from dexnudge.geometry.near_faces import faces_near
from dexnudge.scenes.plane_fit import EXACT, MAD_TO_DEVIATION
from dexnudge.scenes.supports import facing_points

DEPTH = 0.3  # [m] below the object in which there is nothing
RING = 0.05  # [m] around its footprint in which there is a surface
LEVEL = 0.02  # [m] from its lowest point, within which that surface lies
UPWARD = 0.5  # z of the normal of a surface that can carry
LEAST_VERTICES = 12  # of the surface around it
MOST_NOISE = 2e-3  # [m] of that surface about its plane
BEYOND = 0.005  # [m] by which the patch is wider than the footprint
DOWN = np.array([0.0, 0.0, -1.0])


def without_hole_below(environment: trimesh.Trimesh, body: trimesh.Trimesh) -> tuple[trimesh.Trimesh, float | None]:
    """Return surroundings [m, world] with a patch where nothing is below a body [m, world] and a plane is all around it.

    And the noise of that plane [m]; None where there is no patch, or the plane is exact.

    Nothing within 0.3 m under any point of the body, and upward surfaces on its four sides that scatter by at most 2 mm
    about one plane. All others are returned as they are.
    """
    height = float(body.extents[2])
    column = faces_near(environment, body.bounds + np.array([[-RING, -RING, -DEPTH], [RING, RING, 0.0]]))
    if len(column) == 0 or "origin" in environment.metadata:  # depth images have their planes continued already
        return environment, None
    near = trimesh.Trimesh(environment.vertices, environment.faces[column], process=False)
    points = facing_points(body, DOWN)
    if (Rays(near).first_hits(points - height * DOWN, DOWN[None], reach=DEPTH + height)[1] >= 0).any():
        return environment, None
    ring = np.asarray(near.vertices)[np.unique(near.faces[np.asarray(near.face_normals)[:, 2] > UPWARD])]
    (low, high), lowest = body.bounds[:, :2], float(body.bounds[0, 2])
    within = (np.abs(ring[:, :2] - (low + high) / 2) <= (high - low) / 2 + RING).all(axis=1)
    ring = ring[within & (np.abs(ring[:, 2] - lowest) <= LEVEL)]
    sides = [ring[:, 0] < low[0], ring[:, 0] > high[0], ring[:, 1] < low[1], ring[:, 1] > high[1]]
    if len(ring) < LEAST_VERTICES or not all(side.any() for side in sides):
        return environment, None
    plane = np.linalg.lstsq(_affine(ring), ring[:, 2], rcond=None)[0]
    noise = MAD_TO_DEVIATION * float(np.median(np.abs(_affine(ring) @ plane - ring[:, 2])))
    if noise > MOST_NOISE:
        return environment, None
    outline = points[ConvexHull(points[:, :2]).vertices]
    outward = outline - outline.mean(axis=0)
    outline = outline + BEYOND * outward / np.linalg.norm(outward, axis=1, keepdims=True)
    outline[:, 2] = _affine(outline) @ plane
    fan = [[0, index, index + 1] for index in range(1, len(outline) - 1)]  # counter-clockwise: it faces up
    vertices = np.concatenate([environment.vertices, outline])
    faces = np.concatenate([environment.faces, np.array(fan) + len(environment.vertices)])
    filled = trimesh.Trimesh(vertices, faces, process=False)
    filled.metadata.update(environment.metadata)
    area = 1e4 * float(ConvexHull(outline[:, :2]).volume)
    note = (
        f"nothing was measured below the object, as where it lay during the scan: {area:.0f} cm^2 there are assumed to "
        f"go on as the plane around them, noise {1e3 * noise:.1f} mm"
    )
    filled.metadata["notes"] = [*environment.metadata.get("notes", ()), note]
    return filled, noise if noise > EXACT else None


def _affine(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return np.column_stack([points[:, :2], np.ones(len(points))])
