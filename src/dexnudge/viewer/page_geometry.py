"""Meshes as the arrays that a web page draws: positions, normals in bytes, indices, sharp edges, all in base64."""

import base64
from typing import Any

import numpy as np
import trimesh

from dexnudge.viewer.corner_normals import CREASE_ANGLE, corner_normals

LARGEST_MESH = 40_000  # triangles; a finer mesh is thinned, so that a page stays below a few megabytes
NORMAL_SCALE = 127  # normals travel as signed bytes
SHORT_INDEX = 65_536  # vertices that an index of two bytes can count
FIRST_CELL = 1 / 400  # of a mesh's diagonal: cells into which a too fine mesh is thinned
COARSER = 1.25  # by this the cells grow until the mesh is small enough


def encoded(array: np.ndarray) -> str:
    """Base64 of an array's bytes, little-endian."""
    return base64.b64encode(array.astype(array.dtype.newbyteorder("<")).tobytes()).decode("ascii")


def page_geometry(mesh: trimesh.Trimesh) -> dict[str, Any]:
    """`positions` float32 [m], `normals` int8 (x, y, z, 0), `indices`, `edges` float32 pairs of ends [m], `closed`."""
    mesh = thinned(mesh)
    normals = np.rint(corner_normals(mesh).reshape(-1, 3) * NORMAL_SCALE).astype(np.int64)
    corners = np.column_stack([np.asarray(mesh.faces).reshape(-1), normals])
    kept, indices = np.unique(corners, axis=0, return_inverse=True)
    index_type = np.dtype(np.uint16 if len(kept) <= SHORT_INDEX else np.uint32)
    sharp = mesh.face_adjacency_angles > np.radians(CREASE_ANGLE)
    return {
        "positions": encoded(np.asarray(mesh.vertices)[kept[:, 0]].astype(np.float32)),
        "normals": encoded(np.column_stack([kept[:, 1:], np.zeros(len(kept))]).astype(np.int8)),
        "indices": encoded(indices.reshape(-1).astype(index_type)),
        "index_bytes": index_type.itemsize,
        "edges": encoded(np.asarray(mesh.vertices)[mesh.face_adjacency_edges[sharp]].astype(np.float32)),
        "closed": bool(mesh.is_watertight),
    }


def thinned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A mesh of at most 40,000 triangles that looks the same: vertices that share a small cell become one.

    Only for looking at; nothing is ever judged on it.
    """
    cell = float(np.linalg.norm(mesh.extents)) * FIRST_CELL if len(mesh.faces) > LARGEST_MESH else 0.0
    result = mesh
    while len(result.faces) > LARGEST_MESH:
        cells = np.floor((mesh.vertices - mesh.bounds[0]) / cell).astype(np.int64)
        _, cluster = np.unique(cells, axis=0, return_inverse=True)
        cluster = cluster.reshape(-1)
        sums = np.stack([np.bincount(cluster, weights=axis) for axis in mesh.vertices.T], axis=1)
        faces = cluster[mesh.faces]
        distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        faces = faces[distinct]
        _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
        result = trimesh.Trimesh(sums / np.bincount(cluster)[:, None], faces[np.sort(first)], process=False)
        cell *= COARSER
    return result
