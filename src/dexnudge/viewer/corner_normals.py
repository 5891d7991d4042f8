"""Normals at the corners of triangles: smooth over gentle bends, sharp over creases."""

import numpy as np
import trimesh
from jaxtyping import Float

CREASE_ANGLE = 35.0  # [deg] two triangles that bend more than this keep their own normals
LARGEST_FAN = 128  # triangles at one vertex beyond which its corners stay flat: the cost grows with the square
MERGE_DIGITS = 6  # vertices closer than a micrometre are one


def corner_normals(mesh: trimesh.Trimesh) -> Float[np.ndarray, "face 3 3"]:
    """Unit normal at each corner of each triangle, mesh frame.

    The mean, weighted by area, over the triangles that meet in the corner's vertex and bend less than 35 deg from its own.
    """
    triangles = np.asarray(mesh.triangles, dtype=np.float64)
    weighted = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sizes = np.linalg.norm(weighted, axis=1, keepdims=True)
    flat = weighted / np.where(sizes > 0, sizes, 1.0)

    _, merged = np.unique(np.round(mesh.vertices, MERGE_DIGITS), axis=0, return_inverse=True)
    vertex = merged.reshape(-1)[np.asarray(mesh.faces)].reshape(-1)
    order = np.argsort(vertex, kind="stable")
    starts = np.flatnonzero(np.diff(vertex[order], prepend=-1))
    fans = np.diff(np.append(starts, len(order)))
    total = np.repeat(weighted, 3, axis=0)
    for size in np.unique(fans[(fans > 1) & (fans <= LARGEST_FAN)]):
        corners = order[starts[fans == size][:, None] + np.arange(size)]  # (vertex, size)
        own, area = flat[corners // 3], weighted[corners // 3]
        together = np.einsum("vic,vjc->vij", own, own) > np.cos(np.radians(CREASE_ANGLE))
        total[corners] = np.einsum("vij,vjc->vic", together, area)
    lengths = np.linalg.norm(total, axis=1, keepdims=True)
    smooth = np.where(lengths > 0, total / np.where(lengths > 0, lengths, 1.0), [0.0, 0.0, 1.0])
    return smooth.reshape(-1, 3, 3)
