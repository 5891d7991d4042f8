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
    """Halve along the longest side of the bounding box until every part is small enough."""
    if len(chosen) == 0:
        return []
    if len(chosen) <= LARGEST_CLUSTER:
        return [chosen]
    axis = int(np.ptp(points[chosen], axis=0).argmax())
    along = chosen[np.argsort(points[chosen, axis], kind="stable")]
    half = len(along) // 2
    return _split(points, along[:half]) + _split(points, along[half:])


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
