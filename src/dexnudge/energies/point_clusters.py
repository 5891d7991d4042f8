"""Points in small groups with bounding spheres, so that the fused kernel can leave out a whole group by one lookup."""

import numpy as np
from jaxtyping import Float, Int

from dexnudge.energies.kernel_structs import Clusters
from dexnudge.geometry.warp_runtime import WarpStruct, wp

LARGEST_CLUSTER = 12  # points; smaller ones cost more lookups than they save


def cluster_points(
    points: Float[np.ndarray, "p 3"], group: Int[np.ndarray, " p"], groups: int, *, device: str = "cpu"
) -> tuple[WarpStruct, WarpStruct, Int[np.ndarray, " group_and_one"]]:
    """(points by cluster, clusters, where the clusters of each group begin): no cluster holds points of two groups.

    Args:
        points: [m].
        group: of each point, for example its link.
        groups: how many groups there are; some may have no points.
        device: of Warp.
    """
    members: list[Int[np.ndarray, " k"]] = []
    first_of_group = [0]
    for index in range(groups):
        members += _split(points, np.flatnonzero(group == index))
        first_of_group.append(len(members))
    centre, radius = np.zeros((len(members), 3)), np.zeros(len(members))
    for cluster, chosen in enumerate(members):
        low, high = points[chosen].min(axis=0), points[chosen].max(axis=0)
        centre[cluster] = (low + high) / 2
        radius[cluster] = np.linalg.norm(points[chosen] - centre[cluster], axis=1).max()
    order = np.concatenate([np.zeros(0, dtype=np.int64), *members])
    ordered = wp.array(points[order].astype(np.float32), dtype=wp.vec3, device=device)
    clusters = Clusters()
    clusters.first = wp.array(np.cumsum([0, *map(len, members)]).astype(np.int32), dtype=wp.int32, device=device)
    clusters.centre = wp.array(centre.astype(np.float32), dtype=wp.vec3, device=device)
    clusters.radius = wp.array(radius.astype(np.float32), dtype=wp.float32, device=device)
    return ordered, clusters, np.asarray(first_of_group, dtype=np.int32)


def _split(points: Float[np.ndarray, "p 3"], chosen: Int[np.ndarray, " k"]) -> list[Int[np.ndarray, " part"]]:
    """Halves along the longest side of the bounding box until every part is small enough."""
    if len(chosen) == 0:
        return []
    if len(chosen) <= LARGEST_CLUSTER:
        return [chosen]
    axis = int(np.ptp(points[chosen], axis=0).argmax())
    along = chosen[np.argsort(points[chosen, axis], kind="stable")]
    half = len(along) // 2
    return _split(points, along[:half]) + _split(points, along[half:])
