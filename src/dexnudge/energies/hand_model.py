"""A hand's constant arrays for the fused kernel."""

from functools import partial
from itertools import chain

import numpy as np
from jaxtyping import Float, Int

from dexnudge.energies.grid_kernel import pack_grids
from dexnudge.energies.kernel_structs import Clusters, HandModel
from dexnudge.geometry.distance_grid import DistanceGrid, cached_distance_grid
from dexnudge.geometry.warp_runtime import WarpStruct, wp
from dexnudge.hands.hand import Hand
from dexnudge.hands.kinematics import kinematic_tree
from dexnudge.jobs.cached import cached_per_instance

LARGEST_CLUSTER = 12  # points; smaller ones cost more lookups than they save


def cluster_points(
    points: Float[np.ndarray, "p 3"], group: Int[np.ndarray, " p"], groups: int, *, device: str = "cpu"
) -> tuple[WarpStruct, WarpStruct, Int[np.ndarray, " group_and_one"]]:
    """Return (points by cluster, clusters, where the clusters of each group begin): no cluster holds points of two groups.

    Args:
        points: [m].
        group: of each point, for example its link.
        groups: how many groups there are; some may have no points.
        device: of Warp.
    """
    order, first = _halved(points, np.argsort(group, kind="stable"), group)
    placed, sizes = points[order], np.diff(first)
    centre, radius = np.zeros((len(sizes), 3)), np.zeros(len(sizes))
    if len(sizes):
        low, high = (extreme.reduceat(placed, first[:-1]) for extreme in (np.minimum, np.maximum))
        centre = (low + high) / 2
        radius = np.maximum.reduceat(np.linalg.norm(placed - centre.repeat(sizes, axis=0), axis=1), first[:-1])
    first_of_group = np.searchsorted(group[order[first[:-1]]], np.arange(groups + 1))
    ordered = wp.array(placed.astype(np.float32), dtype=wp.vec3, device=device)
    clusters = Clusters()
    clusters.first = wp.array(first.astype(np.int32), dtype=wp.int32, device=device)
    clusters.centre = wp.array(centre.astype(np.float32), dtype=wp.vec3, device=device)
    clusters.radius = wp.array(radius.astype(np.float32), dtype=wp.float32, device=device)
    return ordered, clusters, first_of_group.astype(np.int32)


def _halved(
    points: Float[np.ndarray, "p 3"], order: Int[np.ndarray, " p"], group: Int[np.ndarray, " p"]
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " part_and_one"]]:
    """Halve groups along the longest side of their bounding boxes until every part is small enough.

    Returns the points by part, and where the parts begin.
    """
    first = np.flatnonzero(np.diff(group[order], prepend=-1, append=-2))
    while (sizes := np.diff(first)).max(initial=0) > LARGEST_CLUSTER:
        low, high = (extreme.reduceat(points[order], first[:-1]) for extreme in (np.minimum, np.maximum))
        part, large = np.arange(len(sizes)).repeat(sizes), sizes > LARGEST_CLUSTER
        along = points[order, (high - low).argmax(axis=1)[part]]
        order = order[np.lexsort((np.where(large[part], along, 0.0), part))]
        first = np.sort(np.concatenate([first, (first[:-1] + sizes // 2)[large]]))
    return order, first


LINK_CELL = 0.0015  # [m] grid cell of a digit's link
LARGE_LINK_CELL = 0.003  # [m] of the palm and the base
GRID_PADDING = 0.004  # [m] around a link; clearances are smaller
FREE = 1.0  # [m] distance reported by the grid of a link without geometry


@cached_per_instance
def build_hand_model(hand: Hand, *, device: str = "cpu") -> WarpStruct:
    """Pack the tree, the sparse points, the bounding spheres and the link grids; cached per hand object."""
    links = len(hand.link_names)
    sparse = hand.sparse_points
    centre, radius = np.zeros((links, 3)), np.full(links, -1.0)
    for link, mesh in enumerate(hand.link_meshes):
        if len(mesh.faces):
            centre[link] = mesh.bounds.mean(axis=0)
            radius[link] = np.linalg.norm(mesh.vertices - centre[link], axis=1).max()
    partners: list[list[int]] = [[] for _ in range(links)]
    for one, other in hand.self_collision_pairs:
        partners[one].append(other)
        partners[other].append(one)
    array = partial(wp.array, device=device)
    model = HandModel()
    model.tree = kinematic_tree(hand, device=device)
    model.points, model.clusters, first_cluster = cluster_points(sparse.points, sparse.link, links, device=device)
    model.first_cluster = array(first_cluster, wp.int32)
    model.centre = array(centre.astype(np.float32), wp.vec3)
    model.radius = array(radius.astype(np.float32), wp.float32)
    keypoint = centre.copy()
    keypoint[hand.fingertip_indices] = hand.fingertip_keypoints
    model.keypoint = array(keypoint.astype(np.float32), wp.vec3)
    model.base = -1 if hand.base_link is None else hand.link_names.index(hand.base_link)
    model.partner = array(np.asarray(list(chain.from_iterable(partners)), dtype=np.int32), wp.int32)
    model.first_partner = array(np.cumsum([0, *(len(p) for p in partners)]).astype(np.int32), wp.int32)
    model.grids = pack_grids([_link_grid(hand, link, device) for link in range(links)], device=device)
    return model


def _link_grid(hand: Hand, link: int, device: str) -> DistanceGrid:
    mesh = hand.link_meshes[link]
    if len(mesh.faces) == 0:
        return DistanceGrid(np.full((2, 2, 2), FREE, dtype=np.float32), np.zeros(3), 1.0e-6)
    cell = LINK_CELL if hand.digit_of_link[hand.link_names[link]] else LARGE_LINK_CELL
    lower, upper = mesh.bounds
    return cached_distance_grid(mesh, lower - GRID_PADDING, upper + GRID_PADDING, cell=cell, device=device)
