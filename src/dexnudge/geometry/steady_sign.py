"""Where the sign of the distance to a mesh is surely that of all places around, so that it need not be asked for at each.

Away from a surface its winding number w changes slowly: |grad w| is at most the sum over the edges where the surface ends,
each of length l at a distance r, of l / (4 pi r^2) (the solid angle's gradient is a Biot-Savart integral along the
boundary). A closed surface ends nowhere, and w changes at the surface alone.
"""

import numpy as np
from jaxtyping import Float, Int

from dexnudge.geometry.exact_distance import (
    INSIDE_WINDING_NUMBER,
    SEARCH_RADIUS,
    WINDING_ACCURACY,
    ExactDistance,
    surface_nearest,
)
from dexnudge.geometry.surface_lattice import ragged
from dexnudge.geometry.warp_runtime import launch_in_threads, wp

ROUGHNESS = wp.constant(0.05)  # of w: more than twice what the fast winding number is off
MOST_CHANGE = wp.constant(2.0)  # of w, from which on it may as well be anything
LONGEST_PIECE = 0.1  # [m] of an edge
ROUND = wp.constant(4.0 * np.pi)


@wp.kernel(enable_backward=False)
def _steady(
    first: int,
    mesh: wp.uint64,
    middle: wp.array(dtype=wp.vec3),
    length: wp.array(dtype=float),
    times: wp.array(dtype=float),
    points: wp.array(dtype=wp.vec3),
    within: float,
    sign: wp.array(dtype=wp.int8),
):
    i = first + wp.tid()
    p = points[i]
    sign[i] = wp.int8(0)
    distance, _closest, _face = surface_nearest(mesh, p, within)
    if distance <= within:
        return
    change = float(ROUGHNESS)
    edge = wp.int32(0)
    while edge < length.shape[0] and change < MOST_CHANGE:
        nearest = wp.length(p - middle[edge]) - 0.5 * length[edge] - within
        if nearest <= 0.0:
            return
        change += within * times[edge] * length[edge] / (ROUND * nearest * nearest)
        edge += 1
    if change >= MOST_CHANGE:
        return
    below, above = INSIDE_WINDING_NUMBER - change, INSIDE_WINDING_NUMBER + change
    if wp.mesh_query_point_sign_winding_number(mesh, p, SEARCH_RADIUS, WINDING_ACCURACY, below).sign > 0.0:
        sign[i] = wp.int8(1)
    elif wp.mesh_query_point_sign_winding_number(mesh, p, SEARCH_RADIUS, WINDING_ACCURACY, above).sign < 0.0:
        sign[i] = wp.int8(-1)


def steady_signs(exact: ExactDistance, points: Float[np.ndarray, "n 3"], *, within: float) -> Int[np.ndarray, " n"]:
    """Return -1 or 1 where all places within a distance [m] of a point lie inside or outside, 0 where that is not sure.

    Inside: by the winding number. Beyond the mesh's bounding box, `ExactDistance` takes every place for outside.
    """
    middle, length, times = _pieces(*exact.open_edges)
    given = {
        "middle": (middle - exact.origin, wp.vec3),
        "length": (length, float),
        "times": (times, float),
        "points": (points - exact.origin, wp.vec3),
    }
    arrays = [wp.array(each.astype(np.float32), dtype=kind, device=exact.device) for each, kind in given.values()]
    sign = wp.zeros(len(points), dtype=wp.int8, device=exact.device)
    launch_in_threads(_steady, [len(points)], [exact.packed()[0], *arrays, within, sign], device=exact.device)
    return sign.numpy().astype(np.int64)


def _pieces(
    edges: Float[np.ndarray, "edge 2 3"], times: Int[np.ndarray, " edge"]
) -> tuple[Float[np.ndarray, "piece 3"], Float[np.ndarray, " piece"], Int[np.ndarray, " piece"]]:
    """Cut edges into pieces, whose middle tells better how far they are; return middle, length [m] and times of each."""
    whole = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    counts = np.maximum(np.ceil(whole / LONGEST_PIECE), 1).astype(np.int64)
    edge, place = ragged(counts)
    share = (place + 0.5) / counts[edge]
    middle = edges[edge, 0] + share[:, None] * (edges[edge, 1] - edges[edge, 0])
    return middle, (whole / counts)[edge], times[edge]
