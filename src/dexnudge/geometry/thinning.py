"""Meshes with fewer triangles that look the same."""

import numpy as np
import trimesh

LARGEST_MESH = 40_000  # triangles; a finer mesh is thinned, so that a page stays below a few megabytes
FIRST_CELL = 1 / 400  # of a mesh's diagonal: cells into which a too fine mesh is thinned
COARSER = 1.25  # by this the cells grow until the mesh is small enough


def thinned(mesh: trimesh.Trimesh, *, most: int = LARGEST_MESH) -> trimesh.Trimesh:
    """Return a mesh of at most so many triangles that looks the same: vertices that share a small cell become one.

    Only for looking at; nothing is ever judged on it.
    """
    result, cell = mesh, float(np.linalg.norm(mesh.extents)) * FIRST_CELL
    while len(result.faces) > most:
        result = trimesh.Trimesh((mesh.vertices - mesh.bounds[0]) / cell, mesh.faces, process=False)
        result.merge_vertices(digits_vertex=0)
        result.update_faces(result.nondegenerate_faces() & result.unique_faces())
        result = trimesh.Trimesh(mesh.bounds[0] + cell * result.vertices, result.faces, process=False)
        cell *= COARSER
    return result
