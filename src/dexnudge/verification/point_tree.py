"""A hand's dense points in nested clusters, so that most of them need no distance query."""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_lattice import distinct_rows
from dexnudge.hands.hand import LinkPoints

CLUSTER_SIZES = (256, 16)
"""Most points in a cluster at each level; below the last one stand the points themselves."""


@dataclass(frozen=True)
class Level:
    """Clusters of one size. Each is stood for by one of its own points, so that its distance is also a result.

    point: index of that point. radius: of the ball about it that holds the cluster [m]. first_child, children: the
    cluster's range in the next level.
    """

    point: Int[np.ndarray, " cluster"]
    radius: Float[np.ndarray, " cluster"]
    first_child: Int[np.ndarray, " cluster"]
    children: Int[np.ndarray, " cluster"]


@dataclass(frozen=True)
class PointTree:
    """Clusters of all links' points; no cluster spans two links. Points are indexed as in `points`."""

    points: LinkPoints
    levels: tuple[Level, ...]


def build_tree(points: LinkPoints) -> PointTree:
    """Split each link's points at the median of their widest direction until the clusters are small."""
    clusters = [
        part
        for link in np.unique(points.link)
        for part in _split(points.points, np.flatnonzero(points.link == link), CLUSTER_SIZES[0])
    ]
    levels = []
    for size in CLUSTER_SIZES[1:]:
        parts = [_split(points.points, cluster, size) for cluster in clusters]
        levels.append(_level(points.points, clusters, np.array([len(part) for part in parts])))
        clusters = [cluster for part in parts for cluster in part]
    levels.append(_level(points.points, clusters, np.array([len(cluster) for cluster in clusters])))
    alone = np.concatenate(clusters)
    levels.append(Level(alone, np.zeros(len(alone)), np.zeros_like(alone), np.zeros_like(alone)))
    return PointTree(points, tuple(levels))


def _split(points: Float[np.ndarray, "p 3"], cluster: Int[np.ndarray, " n"], size: int) -> list[Int[np.ndarray, " _"]]:
    if len(cluster) <= size:
        return [cluster]
    widest = int(np.argmax(np.ptp(points[cluster], axis=0)))
    order = cluster[np.argsort(points[cluster, widest], kind="stable")]
    middle = len(order) // 2
    return _split(points, order[:middle], size) + _split(points, order[middle:], size)


def _level(
    points: Float[np.ndarray, "p 3"], clusters: list[Int[np.ndarray, " _"]], count: Int[np.ndarray, " c"]
) -> Level:
    centre, radius = [], []
    for cluster in clusters:
        own = points[cluster]
        index = int(np.argmin(np.linalg.norm(own - 0.5 * (own.min(axis=0) + own.max(axis=0)), axis=1)))
        centre.append(cluster[index])
        radius.append(np.linalg.norm(own - own[index], axis=1).max())
    return Level(np.array(centre), np.array(radius), np.cumsum(count) - count, count)


class SolidDistance:
    """Exact signed distance to a mesh, with its bounding box and the size of its holes.

    Where the surface is closed, signed distance is 1-Lipschitz: a ball about a point farther outside than its radius
    holds no inner point. Through a hole of diameter h the sign may change without the surface being met; then the
    ball must be h farther away. A mesh whose triangles disagree about the outside has no such bound (infinity).
    `widest_hole` [m] bounds h: through a wider opening, such as the border of a scan, the sign changes in free air, far
    from any surface, where it means nothing.
    """

    def __init__(
        self, mesh: trimesh.Trimesh, query: ExactDistance | None = None, *, widest_hole: float = np.inf
    ) -> None:
        self.query = query or ExactDistance(mesh)
        self.low, self.high = np.asarray(mesh.bounds, dtype=np.float64)
        self.hole = min(hole_diameter(mesh), widest_hole)


def hole_diameter(mesh: trimesh.Trimesh) -> float:
    """Largest diagonal of the bounding box of a connected set of open edges [m]; infinite where orientations clash."""
    if mesh.is_watertight:
        return 0.0
    if not mesh.is_winding_consistent:
        return np.inf
    edges = np.asarray(mesh.edges_sorted)
    first, edge = distinct_rows(edges)
    open_edges = edges[first][np.bincount(edge) % 2 == 1]
    groups = trimesh.graph.connected_components(open_edges)
    return max((float(np.linalg.norm(np.ptp(mesh.vertices[group], axis=0))) for group in groups), default=0.0)


@dataclass(frozen=True)
class PointHits:
    """Points within reach of a solid: whose they are, and what the distance query found, in the solid's frame."""

    configuration: Int[np.ndarray, " hit"]
    point: Int[np.ndarray, " hit"]
    distance: Float[np.ndarray, " hit"]
    closest: Float[np.ndarray, "hit 3"]
    normal: Float[np.ndarray, "hit 3"]


def query_tree(
    tree: PointTree,
    T_solid_link: Float[np.ndarray, "n link 4 4"],
    solid: SolidDistance,
    *,
    links: Bool[np.ndarray, " link"],
    reach: float,
    deepest: Float[np.ndarray, " n"] | None = None,
) -> PointHits:
    """Return the hits of all points of the chosen links within `reach` [m] of the solid (those inside it included).

    deepest: if given, depths [m] already known per configuration; they are raised in place to the greatest depth
    found in the solid grown by `reach`, and points that cannot be deeper are left out of the hits.
    """
    level = tree.levels[0]
    chosen = np.flatnonzero(links[tree.points.link[level.point]])
    configuration = np.repeat(np.arange(len(T_solid_link)), len(chosen))
    cluster = np.tile(chosen, len(T_solid_link))
    for depth, level in enumerate(tree.levels):
        if depth:
            above = tree.levels[depth - 1]
            count = above.children[cluster]
            place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
            configuration = np.repeat(configuration, count)
            cluster = np.repeat(above.first_child[cluster], count) + place
        index, radius = level.point[cluster], level.radius[cluster]
        T = T_solid_link[configuration, tree.points.link[index]]
        centre = np.einsum("nij,nj->ni", T[:, :3, :3], tree.points.points[index]) + T[:, :3, 3]
        margin = (radius + reach)[:, None]
        kept = np.flatnonzero(np.all((centre >= solid.low - margin) & (centre <= solid.high + margin), axis=1))
        hit = solid.query(centre[kept])
        bound = reach + radius[kept] + np.where(radius[kept] > 0, solid.hole, 0.0)
        inner = hit.distance <= bound
        if deepest is not None:
            np.maximum.at(deepest, configuration[kept], reach - hit.distance)
            inner &= bound - hit.distance >= deepest[configuration[kept]]
        configuration, cluster = configuration[kept][inner], cluster[kept][inner]
    index = tree.levels[-1].point[cluster]
    return PointHits(configuration, index, hit.distance[inner], hit.closest[inner], hit.normal[inner])
