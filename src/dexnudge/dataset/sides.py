"""From which side a hand touches an object, and from where it comes, in the object's resting frame."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

SIDES = ("top", "+x", "-x", "+y", "-y", "bottom")  # an index of a side points into this tuple
NORMALS = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]], dtype=np.float64)
OCTANTS = ("+x", "+x+y", "+y", "-x+y", "-x", "-x-y", "-y", "+x-y")  # 45 degrees each, counter-clockwise, about an axis
NEIGHBOURS = 32  # stored surface points that may lie on the contact's own face; the nearest may lie round an edge
NEARNESS = 0.1  # weight of a point's distance against the distance of its tangent plane


def surface_normals(points: Float[np.ndarray, "n 3"], cloud: Float[np.ndarray, "point 6"]) -> Float[np.ndarray, "n 3"]:
    """Outward unit normal of the object at points of its surface [m], from stored surface points with normals.

    Each takes the normal of the neighbour c whose tangent plane it lies on: the least |n_c (p - c)| + 0.1 |p - c|.
    """
    neighbours = min(NEIGHBOURS, len(cloud))
    distance, index = cKDTree(cloud[:, :3]).query(points, k=[*range(1, neighbours + 1)])
    normals = cloud[index, 3:]
    off_plane = np.abs(np.einsum("nki,nki->nk", normals, points[:, None] - cloud[index, :3]))
    best = np.argmin(off_plane + NEARNESS * distance, axis=1)
    return normals[np.arange(len(points)), best]


def contact_sides(points: Float[np.ndarray, "n 3"], cloud: Float[np.ndarray, "point 6"]) -> Int[np.ndarray, " n"]:
    """Index into `SIDES` of the direction that is closest to the surface's normal at each contact point [m]."""
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    return np.argmax(surface_normals(points, cloud) @ NORMALS.T, axis=1)


def palm_octants(translation: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Index into `OCTANTS` of the azimuth at which the palm's origin stands around the object's centre."""
    azimuth = np.arctan2(translation[:, 1], translation[:, 0])
    return np.rint(azimuth / (np.pi / 4)).astype(np.int64) % len(OCTANTS)
