"""A hand's dense points in nested balls, so that most of them need no distance query."""

from array import array
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from dexnudge.geometry.warp_runtime import WarpStruct, launch_in_threads, wp
from dexnudge.hands.hand import LinkPoints
from dexnudge.verification.solid_kernel import Hits, Nodes, points_in_solids
from dexnudge.verification.solids import SolidDistance, Solids

CLUSTER_SIZES = (2048, 256, 16)
"""Most points in a cluster at each level; below the last one stand the points themselves."""
EXPECTED_HITS = 256
"""Of each hand; where there are more, they are looked for again."""
AT_ONCE = 1024
"""Hands whose hits are looked for in one launch, to bound memory."""


@dataclass(frozen=True)
class PointTree:
    """All points of all links, each with a ball; a cluster is stood for by one of its own points.

    Depth first, link by link: what is in the ball of a node stands right behind it.

    Attributes:
        points: as in the hand.
        index: of each node's point. radius: of the ball about it that holds its cluster [m]; 0 for a point alone.
        after: the first node that is not in the ball.
        first: where the nodes of each link begin; behind them their number.
        place: of each node in the order of points by halves, in which hits are returned.
        device: of Warp.
    """

    points: LinkPoints
    index: Int[np.ndarray, " node"]
    radius: Float[np.ndarray, " node"]
    after: Int[np.ndarray, " node"]
    first: Int[np.ndarray, " link_and_one"]
    place: Int[np.ndarray, " node"]
    device: str = "cpu"

    @property
    def num_links(self) -> int:
        """Of the hand, those without points included."""
        return len(self.first) - 1

    @cached_property
    def packed(self) -> WarpStruct:
        """The tree as the kernel takes it."""
        nodes = Nodes()
        nodes.point = wp.array(self.points.points[self.index], dtype=wp.vec3d, device=self.device)
        nodes.radius = wp.array(self.radius, dtype=wp.float64, device=self.device)
        nodes.after = wp.array(self.after.astype(np.int32), dtype=int, device=self.device)
        nodes.first = wp.array(self.first.astype(np.int32), dtype=int, device=self.device)
        return nodes


def build_tree(points: LinkPoints, *, num_links: int, device: str = "cpu") -> PointTree:
    """Split each link's points at the median of their widest direction until the clusters are small."""
    nodes = _Columns()
    first = []
    for link in range(num_links):
        first.append(len(nodes.index))
        for cluster in _split(points.points, np.flatnonzero(points.link == link), CLUSTER_SIZES[0]):
            _add(points.points, cluster, nodes)
    index, radius, after = (np.array(column) for column in (nodes.index, nodes.radius, nodes.after))
    order = [
        _split(points.points, np.flatnonzero(points.link == link), CLUSTER_SIZES[-1]) for link in np.unique(points.link)
    ]
    place = np.empty(len(index), dtype=np.int64)
    place[np.concatenate([part for parts in order for part in parts])] = np.arange(len(index))
    return PointTree(points, index, radius, after, np.array([*first, len(index)]), place[index], device)


@dataclass(frozen=True)
class _Columns:
    """The nodes of a tree that grows: a quarter of what a tuple for each takes."""

    index: "array[int]" = field(default_factory=lambda: array("q"))
    radius: "array[float]" = field(default_factory=lambda: array("d"))
    after: "array[int]" = field(default_factory=lambda: array("q"))


def _add(points: Float[np.ndarray, "p 3"], cluster: Int[np.ndarray, " n"], nodes: _Columns) -> None:
    """Append a cluster: the point that stands for it, then what else is in it."""
    own = points[cluster]
    middle = int(np.argmin(np.linalg.norm(own - 0.5 * (own.min(axis=0) + own.max(axis=0)), axis=1)))
    radius = float(np.linalg.norm(own - own[middle], axis=1).max())
    place = len(nodes.index)
    nodes.index.append(int(cluster[middle]))
    nodes.radius.append(radius)
    nodes.after.append(0)
    rest = np.delete(cluster, middle)
    size = next((size for size in CLUSTER_SIZES if size < len(rest)), 1)
    if size > 1:
        for part in _split(points, rest, size):
            _add(points, part, nodes)
    else:
        nodes.index.extend(rest.tolist())
        nodes.radius.extend([0.0] * len(rest))
        nodes.after.extend(range(place + 2, place + 2 + len(rest)))
    nodes.after[place] = len(nodes.index)


def _split(points: Float[np.ndarray, "p 3"], cluster: Int[np.ndarray, " n"], size: int) -> list[Int[np.ndarray, " _"]]:
    if len(cluster) <= size:
        return [cluster] if len(cluster) else []
    widest = int(np.argmax(np.ptp(points[cluster], axis=0)))
    order = cluster[np.argsort(points[cluster, widest], kind="stable")]
    middle = len(order) // 2
    return _split(points, order[:middle], size) + _split(points, order[middle:], size)


@dataclass(frozen=True)
class PointHits:
    """Points within reach of a solid: whose they are, and what the distance query found, in the solid's frame."""

    configuration: Int[np.ndarray, " hit"]
    point: Int[np.ndarray, " hit"]
    distance: Float[np.ndarray, " hit"]
    closest: Float[np.ndarray, "hit 3"]
    normal: Float[np.ndarray, "hit 3"]


def near_points(
    tree: PointTree, T_solid_link: Float[np.ndarray, "n link 4 4"], solid: SolidDistance, *, reach: float
) -> PointHits:
    """Return the hits of all points within `reach` [m] of the solid (those inside it included), hand by hand."""
    parts, room = [], EXPECTED_HITS
    solids, here, every = Solids([solid], device=tree.device), np.eye(4)[None, None], np.ones((1, tree.num_links), bool)
    for first in range(0, len(T_solid_link), AT_ONCE):
        poses = T_solid_link[first : first + AT_ONCE]
        while True:
            hits = _room_for(len(poses), room, tree.device)
            _launch(tree, poses, here, solids, every, reach, hits=hits)
            count = hits.count.numpy()
            if count.max() <= room:
                break
            room = int(count.max())
        taken = np.arange(room) < count[:, None]
        configuration, node = np.repeat(np.arange(len(poses)), count), hits.node.numpy()[taken]
        order = np.lexsort((tree.place[node], configuration))
        distance, closest, face = (
            getattr(hits, name).numpy()[taken][order] for name in ("distance", "closest", "face")
        )
        parts.append((first + configuration, tree.index[node[order]], distance, closest, face))
    configuration, point, distance, closest, face = (np.concatenate(column) for column in zip(*parts, strict=True))
    return PointHits(
        configuration=configuration,
        point=point,
        distance=distance.astype(np.float64),
        closest=closest.astype(np.float64) + solid.query.origin,
        normal=solid.query.face_normals[face],
    )


def raise_depths(
    tree: PointTree,
    T_frame_link: Float[np.ndarray, "n link 4 4"],
    T_solid_frame: Float[np.ndarray, "#n solid 4 4"],
    solids: Solids,
    *,
    asked: Bool[np.ndarray, "solid link"],
    reach: float,
    deepest: Float[np.ndarray, " n"],
) -> None:
    """Raise depths [m] already known to the greatest one of the links' points in the solids grown by `reach` [m].

    T_solid_frame: of each solid, the same for all hands or one of each. asked: whose points are looked for in which solid.
    """
    if not len(deepest):
        return
    depths = wp.array(deepest, dtype=wp.float64, device=tree.device)
    _launch(tree, T_frame_link, T_solid_frame, solids, asked, reach, deepest=depths)
    deepest[:] = depths.numpy()


def _room_for(hands: int, count: int, device: str) -> WarpStruct:
    hits = Hits()
    hits.count = wp.zeros(hands, dtype=int, device=device)
    for name, dtype in (("node", int), ("distance", float), ("closest", wp.vec3), ("face", int)):
        setattr(hits, name, wp.empty((hands, count), dtype=dtype, device=device))
    return hits


def _launch(
    tree: PointTree,
    T_frame_link: Float[np.ndarray, "n link 4 4"],
    T_solid_frame: Float[np.ndarray, "#n solid 4 4"],
    solids: Solids,
    asked: Bool[np.ndarray, "solid link"],
    reach: float,
    *,
    hits: WarpStruct | None = None,
    deepest: Any = None,
) -> None:
    """Look for hits, or raise the depths of an array of Warp's."""
    device = tree.device
    inputs = [
        tree.packed,
        wp.array(T_frame_link, dtype=wp.mat44d, device=device),
        wp.array(T_solid_frame, dtype=wp.mat44d, device=device),
        *solids.packed,
        wp.array(asked.astype(np.int32), dtype=int, device=device),
        reach,
        hits is None,
        hits or _room_for(0, 0, device),
        deepest if hits is None else wp.zeros(0, dtype=wp.float64, device=device),
    ]
    launch_in_threads(points_in_solids, (len(T_frame_link), len(solids)), inputs, device=device)
