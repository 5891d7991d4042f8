"""The part of a mesh near a box."""

from __future__ import annotations

import numpy as np
import trimesh
from jaxtyping import Float, Int


def faces_near(mesh: trimesh.Trimesh, bounds: Float[np.ndarray, "2 3"]) -> Int[np.ndarray, " near"]:
    """Return the faces of a mesh whose boxes touch the given bounds [m]; few operations for each vertex of a large mesh."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    near = np.arange(len(faces))
    for axis in range(3):
        for outside in (vertices[:, axis] < bounds[0, axis], vertices[:, axis] > bounds[1, axis]):
            near = near[~outside[faces[near]].all(axis=1)]
    return near
