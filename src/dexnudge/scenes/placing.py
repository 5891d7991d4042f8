"""An object lying on the plane z = 0, turned about the vertical, with the size of what it covers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.scenes.boxes import shift, turn
from dexnudge.scenes.resting import resting_pose


@dataclass(frozen=True)
class Lying:
    """The object on z = 0, the centre of its bounding box above the origin.

    `pose`: (4, 4) object frame to world. `size`: (3,) of the bounding box in the world [m]. `yaw` [rad].
    """

    mesh: trimesh.Trimesh
    pose: Float[np.ndarray, "4 4"]
    size: Float[np.ndarray, "3"]
    yaw: float

    def at(self, x: float, y: float, z: float = 0.0) -> Float[np.ndarray, "4 4"]:
        """Pose with the centre of the bounding box above (x, y) and the lowest point at height z [m]."""
        return shift(x, y, z) @ self.pose

    def footprint(self) -> Float[np.ndarray, "n 2"]:
        """World x and y of all vertices of the convex hull."""
        hull = np.asarray(self.mesh.convex_hull.vertices)
        return (hull @ self.pose[:3, :3].T + self.pose[:3, 3])[:, :2]


def lay_down(mesh: trimesh.Trimesh, yaw: float) -> Lying:
    """The object on its most stable face; at `yaw` = 0 its long side is along x."""
    pose = turn(yaw) @ resting_pose(mesh)
    placed = np.asarray(mesh.vertices) @ pose[:3, :3].T + pose[:3, 3]
    low, high = placed.min(axis=0), placed.max(axis=0)
    centred = shift(-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]) @ pose
    return Lying(mesh, centred, high - low, float(yaw))
