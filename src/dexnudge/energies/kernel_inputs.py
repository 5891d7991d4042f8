"""What the fused kernel is given: the distance fields of an object and its environment, in one frame; and the hand."""

from functools import partial
from itertools import chain

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.ndimage import map_coordinates, minimum_filter1d

from dexnudge.energies.environment_grids import carried_grid, occluded_grids
from dexnudge.energies.grid_kernel import pack_grids
from dexnudge.energies.kernel_structs import Clusters, HandModel, SceneFields
from dexnudge.geometry.distance_grid import DistanceGrid, cached_distance_grid, distance_grid
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_lattice import ragged
from dexnudge.geometry.surface_points import surface_points
from dexnudge.geometry.warp_runtime import WarpStruct, wp
from dexnudge.hands.hand import Hand
from dexnudge.hands.kinematics import kinematic_tree
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.motion import Motion


def _swept(grid: DistanceGrid, motion: Motion, *, around: DistanceGrid | None = None) -> DistanceGrid:
    if motion.turn is not None:
        return carried_grid(grid, motion, around=around, relevant=RELEVANT)
    return swept_grid(grid, motion.slide_length * motion.direction, around=around)


def swept_grid(
    grid: DistanceGrid, displacement: Float[np.ndarray, " 3"], *, around: DistanceGrid | None = None
) -> DistanceGrid:
    """Return the least distance [m] that each corner of a grid meets along its path; exact up to half a cell at the end.

    Args:
        grid: signed distances [m] to the environment.
        displacement: m times L [m], in the frame of the grid, along one of its axes; what it has across the axis of its
            largest component is neglected. Where it is shorter than half a cell, `grid` itself is returned.
        around: a larger grid of the same distances, looked up where the path leaves `grid`; without it that part of the path
            does not count.
    """
    axis = int(np.abs(displacement).argmax())
    sign = 1 if displacement[axis] > 0 else -1
    steps = round(abs(float(displacement[axis])) / grid.cell)
    if steps == 0:
        return grid
    count = grid.values.shape[axis]
    along = grid.values
    if around is not None:
        along = np.concatenate([grid.values, _ahead(grid, around, axis, sign, steps)][::sign], axis=axis)
    forward = np.flip(along, axis) if sign < 0 else along
    # Shifted so that the window of each corner begins at the corner itself.
    least = minimum_filter1d(forward, steps + 1, axis=axis, origin=-((steps + 1) // 2), mode="nearest")
    least = np.take(least, np.arange(count), axis=axis)
    return DistanceGrid(np.flip(least, axis) if sign < 0 else least, grid.origin, grid.cell)


def _ahead(grid: DistanceGrid, around: DistanceGrid, axis: int, sign: int, steps: int) -> Float[np.ndarray, "x y z"]:
    """Distances of the larger grid at the corners by which `grid` would be continued in the direction of the path."""
    counts = list(grid.values.shape)
    counts[axis] = steps
    origin = np.array(grid.origin, dtype=np.float64)
    origin[axis] += grid.cell * (grid.values.shape[axis] if sign > 0 else -steps)
    corners = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"))
    places = (origin[:, None, None, None] + grid.cell * corners - around.origin[:, None, None, None]) / around.cell
    return map_coordinates(around.values, places, order=1, mode="nearest").astype(grid.values.dtype)


OBJECT_CELL = 0.001  # [m]
OBJECT_PADDING = 0.008  # [m]
OBJECT_POINT_SPACING = 0.006  # [m] of the object's points that are tested against the links
NEAR_CELL, NEAR_PADDING = 0.004, 0.05  # [m] environment around the object
FAR_CELL, FAR_REACH = 0.012, 0.34  # [m] environment wherever the hand can be while it touches the object
RELEVANT = 0.08  # [m] of the environment's distances: more than the largest clearance and a coarse cell
EDGE_POINT_SPACING = 0.004  # [m] along the environment's sharp edges
SHARP_EDGE = np.radians(30.0)  # dihedral angle above which an edge can dig into a link between two of its points
NO_ENVIRONMENT = 10.0  # [m] distance everywhere when there is none


def build_scene_fields(object_mesh: trimesh.Trimesh, environment_mesh: trimesh.Trimesh | None) -> WarpStruct:
    """Return grids and test points from meshes that are already in the working frame [m]: a `SceneFields` of the kernel."""
    return build_guided_fields(object_mesh, environment_mesh, guiding=False)[0]


def build_guided_fields(
    object_mesh: trimesh.Trimesh,
    environment_mesh: trimesh.Trimesh | None,
    *,
    device: str = "cpu",
    guiding: bool = True,
    motion: Motion | None = None,
) -> tuple[WarpStruct, WarpStruct]:
    """Return (fields of the scene, the same with occluded space as solid, for guidance); equal without `guiding`.

    Args:
        object_mesh: in the working frame [m].
        environment_mesh: in the same frame; None where there is none.
        device: of Warp.
        guiding: whether the second is wanted.
        motion: in the working frame, a slide along an axis of it. With it the environment's grids also stand swept along
            the motion, for the weight `sweep`.
    """
    lower, upper = object_mesh.bounds
    object_grid = cached_distance_grid(
        object_mesh, lower - OBJECT_PADDING, upper + OBJECT_PADDING, cell=OBJECT_CELL, device=device
    )
    empty = DistanceGrid(np.full((2, 2, 2), NO_ENVIRONMENT, dtype=np.float32), np.zeros(3), 1.0e-6)
    environment, edge_points = [empty, empty], np.zeros((0, 3))
    occluded = environment
    swept: list[DistanceGrid] = []
    if environment_mesh is not None:
        around = ExactDistance(environment_mesh, device=device)
        environment = [
            distance_grid(around, lower - padding, upper + padding, cell=cell, relevant=RELEVANT)
            for padding, cell in ((NEAR_PADDING, NEAR_CELL), (FAR_REACH, FAR_CELL))
        ]
        if motion is not None:
            near, far = environment
            swept = [_swept(near, motion, around=far), _swept(far, motion)]
        edge_points = sharp_edge_points(environment_mesh, lower - FAR_REACH, upper + FAR_REACH)
        if guiding:
            occluded = occluded_grids(environment, object_mesh, environment_mesh, around)
    spread = surface_points(object_mesh, spacing=OBJECT_POINT_SPACING).points
    on_object, on_edges = (
        cluster_points(points, np.zeros(len(points), dtype=np.int32), 1, device=device)[:2]
        for points in (spread, edge_points)
    )

    def fields(grids: list[DistanceGrid]) -> WarpStruct:
        packed = SceneFields()
        # Occlusion belongs to where the hand stands now, so it is not swept; but nothing swept is above it.
        lowest = [
            DistanceGrid(np.minimum(one.values, other.values), one.origin, one.cell)
            for one, other in zip(grids, swept, strict=False)
        ]
        packed.grids = pack_grids([object_grid, *grids, *lowest], device=device)
        packed.object_points, packed.object_clusters = on_object
        packed.environment_points, packed.environment_clusters = on_edges
        packed.has_environment = int(environment_mesh is not None)
        packed.has_sweep = int(bool(swept))
        return packed

    plain = fields(environment)
    return plain, fields(occluded) if guiding and environment_mesh is not None else plain


def sharp_edge_points(
    mesh: trimesh.Trimesh, lower: Float[np.ndarray, " 3"], upper: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "n 3"]:
    """Return points along convex sharp edges inside a box [m]: they can enter a link between two of its points."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    above, below = vertices >= lower, vertices <= upper
    near = (above[faces].any(axis=1) & below[faces].any(axis=1)).all(axis=1)
    mesh = trimesh.Trimesh(vertices, faces[near], process=False)
    sharp = (mesh.face_adjacency_angles > SHARP_EDGE) & mesh.face_adjacency_convex
    start, end = np.moveaxis(vertices[mesh.face_adjacency_edges[sharp]], 1, 0)
    steps = np.maximum(np.ceil(np.linalg.norm(end - start, axis=1) / EDGE_POINT_SPACING), 1.0).astype(np.int64)
    edge, place = ragged(steps + 1)
    share = np.where(place == steps[edge], 1.0, place * (1.0 / steps[edge]))
    along = start[edge] + share[:, None] * (end - start)[edge]
    return along[((along >= lower) & (along <= upper)).all(axis=1)]


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
