"""Depth views fused into one surface of the surroundings: free, seen and unseen space kept apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int, Int8, UInt8
from scipy.ndimage import label, maximum_filter, minimum_filter

from dexnudge.errors import SceneError, quote
from dexnudge.geometry.warp_runtime import wp
from dexnudge.perception.depth_view import AXIAL_NOISE, DepthView
from dexnudge.perception.fusion_kernel import COMPLETED, MEASURED, OF_OBJECT, fit_planes, integrate

LARGEST_FIT = 4_000_000  # pixels; larger images are thinned, which bounds memory and time
WIDEST_WINDOW = 8  # pixels to each side: more would take longer and show nothing that a voxel could
LEAST_SHARE = 0.3  # of a window that must be measured: a pixel that dropped out is bridged, a hole is not
STEEPEST = 0.15  # cosine between surface and ray, 81 degrees: flatter ones are noise or an edge
SPREAD = 3.0  # standard deviations of the camera's noise by which depth may leave the plane before it is an edge


@dataclass(frozen=True, eq=False)
class LocalPlanes:
    """What a depth image says of surface and free space; camera frame.

    `planes`: unit normal n toward the camera and offset c [m]: n @ x + c is the distance before the surface. `weights`:
    cosine between normal and ray times the share of the window that is measured, 0 where there is no surface, negative
    where its depth was assumed. `free`: depth [m] up
    to which nothing stands where there is no surface, 0 = not known. `intrinsics`: fx, fy, cx, cy [px] of these arrays.
    """

    planes: Float[np.ndarray, "height width 4"]
    weights: Float[np.ndarray, "height width"]
    free: Float[np.ndarray, "height width"]
    intrinsics: Float[np.ndarray, "4"]


def local_planes(view: DepthView, *, footprint: float) -> LocalPlanes:
    """Fit a plane at each pixel over a window of about `footprint` [m] on the surface.

    Pixels of the object (`mask`, unless their depth is `assumed`) give no surface, but what is before them is free. Where
    depth jumps within the window there is no surface either, and what is a footprint before the nearest pixel is free.
    """
    step = int(np.ceil(np.sqrt(view.depth.size / LARGEST_FIT)))
    depth = np.ascontiguousarray(view.depth[::step, ::step])
    intrinsics = np.asarray([view.fx, view.fy, view.cx, view.cy]) / step
    kinds = np.ascontiguousarray(_kinds(view)[::step, ::step])
    middle = np.median(depth[depth > 0]) if depth.any() else 1.0
    half = int(np.clip(np.rint(0.5 * footprint * intrinsics[:2].min() / middle), 1, WIDEST_WINDOW))
    planes = wp.empty(depth.shape, dtype=wp.vec4, device="cpu")
    weights, free = (wp.empty(depth.shape, dtype=float, device="cpu") for _ in range(2))
    given = [wp.array(values, dtype=kind, device="cpu") for values, kind in ((depth, float), (kinds, wp.uint8))]
    inputs = [*given, wp.vec4(*intrinsics), half, footprint, LEAST_SHARE, STEEPEST, wp.vec3(*AXIAL_NOISE), SPREAD]
    wp.launch(fit_planes, dim=depth.shape, inputs=inputs, outputs=[planes, weights, free], device="cpu")
    return LocalPlanes(planes.numpy(), weights.numpy(), free.numpy(), intrinsics)


def _kinds(view: DepthView) -> UInt8[np.ndarray, "height width"]:
    """Return what each pixel's depth is."""
    kinds = np.where(view.measured, MEASURED, 0).astype(np.uint8)
    if view.mask is not None:
        kinds[view.measured & view.mask] = OF_OBJECT
    if view.assumed is not None:
        kinds[view.measured & view.assumed] = COMPLETED
    return kinds


SEEN, ASSUMED, UNSEEN = 0, 1, 2  # origins of a face
VOXEL = 0.004  # [m] twice the noise of a structured-light camera a metre away
SMALLEST_VOXEL, LARGEST_VOXEL = 0.0005, 0.1  # [m] finer than any depth camera; coarser than any hand
MAX_VOXELS = 60_000_000  # of one grid: three numbers each take 0.7 GB
TRUNCATION = 3.0  # voxels before a surface in which its distance counts (Newcombe et al. 2011)
BEHIND = 2.0  # voxels behind it, so that things as thin as this keep both sides; the weight falls over
DECAY_FROM = 1.0  # voxels behind it (Bylow et al. 2013)
ASSUMED_WEIGHT = 0.1  # of a measurement: where both speak, what was measured decides
EDGE_WEIGHT = 0.1  # of free space beside an edge, where the nearest of several depths counts
STEEPEST_CHANGE = 2.0  # voxels of distance from a node to the next; beyond it no surface was seen between them
GAP = 2  # voxels between free ones that no ray passed: too narrow for a thing that no ray meets either
SPECK = 27  # voxels; smaller bodies that float, and smaller bubbles, are noise


@dataclass(frozen=True, eq=False)
class FusedSurface:
    """The boundary of what is solid, in the world [m].

    `mesh`: closed, normals toward free space. `origin` of each face: SEEN, ASSUMED (its depth was completed), or UNSEEN
    (the border of space that no view looked into, and of the box). `free`, `seen`, `unseen`: voxels known to be free, to
    be solid, and not known. `voxel` [m].
    """

    mesh: trimesh.Trimesh
    origin: Int8[np.ndarray, " face"]
    free: int
    seen: int
    unseen: int
    voxel: float


@dataclass(frozen=True, eq=False)
class EmptySpace:
    """Space that is free whatever the views say, such as the object's own.

    `low`, `high`: corners of a box around it [m, world]. `distance`: signed, of points (n, 3), negative inside [m].
    `unseen_margin` [m]: by which it is larger where no view looked.
    """

    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]
    distance: Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, " n"]]
    unseen_margin: float = 0.0


def fuse(
    views: Sequence[DepthView],
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
    *,
    voxel: float = VOXEL,
    unseen: str = "solid",
    empty: EmptySpace | None = None,
) -> FusedSurface:
    """Fuse views over the box from `low` to `high` [m, world].

    Each voxel's signed distance is the weighted mean over the views of the distance to the plane at the pixel that it is
    seen in, truncated; weights are the cosine between surface and ray, times the share of pixels measured there (Curless
    and Levoy, SIGGRAPH 1996; Newcombe et al., KinectFusion, ISMAR 2011). What lies more than two voxels behind a surface
    was not seen.

    Pixels without depth are no evidence. The object's pixels (`mask`, where depth is not `assumed`) give no surface, but
    what lies before them is free. Voxels that no view looked into are solid or free, as `unseen` says; if they are free,
    what was seen is a shell of that thickness. Space that is `empty` is free in any case.

    Raises:
        SceneError: a box or voxel that no grid can have, too many voxels, or no view that measured anything in the box.
    """
    low, counts = _grid(low, high, voxel)
    if not any(_measures(view, low, low + voxel * np.asarray(counts)) for view in views):
        raise SceneError(
            f"none of the {len(views)} views measures anything between {low.tolist()} and {np.asarray(high).tolist()} m; "
            "expected a box in sight; are `T_world_camera` and the object's pose in one frame, in metres?"
        )
    distance, known, guessed = _integrated(views, low, counts, voxel)
    inner = (slice(1, -1),) * 3
    not_seen = ~known[inner] & ~_gaps(known[inner], distance[inner])
    seen_voxels = int((distance[inner] < 0).sum())
    distance[inner][not_seen] = -1.0 if unseen == "solid" else 1.0
    if empty is not None:
        _empty(distance[inner], not_seen, low, voxel, empty)
    _drop_specks(distance[inner])
    _close(distance)
    vertices, faces, nodes = isosurface(distance)
    first, second = (tuple(nodes[:, end].T) for end in (0, 1))
    seen_here = known[first] & known[second]
    seen_here &= np.abs(distance[first] - distance[second]) <= STEEPEST_CHANGE / TRUNCATION
    kinds = np.where(seen_here, np.where(guessed[first] | guessed[second], ASSUMED, SEEN), UNSEEN).astype(np.int8)
    return FusedSurface(
        mesh=trimesh.Trimesh(low + voxel * (vertices - 0.5), faces, process=False),
        origin=kinds[faces].max(axis=1, initial=SEEN).astype(np.int8),
        free=not_seen.size - seen_voxels - int(not_seen.sum()),
        seen=seen_voxels,
        unseen=int(not_seen.sum()),
        voxel=voxel,
    )


def _grid(low: np.ndarray, high: np.ndarray, voxel: float) -> tuple[Float[np.ndarray, "3"], tuple[int, int, int]]:
    """Return the box's lower corner and the voxels along each axis."""
    if not SMALLEST_VOXEL <= voxel <= LARGEST_VOXEL:
        raise SceneError(f"`voxel` is {quote(voxel)} m; expected {SMALLEST_VOXEL:g} to {LARGEST_VOXEL:g}")
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    size = high - low
    if size.shape != (3,) or not (size > voxel).all() or not np.isfinite(size).all():
        raise SceneError(f"the box from {low.tolist()} to {high.tolist()} m has no room; expected `low` below `high`")
    needed = float(np.prod(np.ceil(size / voxel)))
    if needed > MAX_VOXELS:
        enough = voxel
        while np.prod(np.ceil(size / enough)) > MAX_VOXELS:
            enough *= 1.05
        raise SceneError(
            f"a box of {' x '.join(f'{edge:.3g}' for edge in size)} m at {1e3 * voxel:g} mm has {needed:.3g} voxels; "
            f"expected at most {MAX_VOXELS:g}; make the box smaller, or `voxel` at least {np.ceil(1e4 * enough) / 1e4:.4f} m"
        )
    x, y, z = np.ceil(size / voxel - 1e-9).astype(int).tolist()
    return low, (x, y, z)


def _measures(view: DepthView, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> bool:
    points = view.points()
    return bool(((points >= low) & (points <= high)).all(axis=1).any())


def _integrated(
    views: Sequence[DepthView], low: Float[np.ndarray, "3"], counts: tuple[int, int, int], voxel: float
) -> tuple[Float[np.ndarray, "x y z"], Bool[np.ndarray, "x y z"], Bool[np.ndarray, "x y z"]]:
    """Return distance over truncation, whether any view speaks, and whether guesses decide, with a margin of a node."""
    shape = tuple(count + 2 for count in counts)
    sums, totals = (wp.zeros(shape, dtype=float, device="cpu") for _ in range(2))
    some_assumed = any(view.assumed is not None and view.assumed.any() for view in views)
    guesses = wp.zeros(shape if some_assumed else (0, 0, 0), dtype=float, device="cpu")
    for view in views:
        pixels = local_planes(view, footprint=voxel)
        rotation = view.T_world_camera[:3, :3]
        first = (low + 0.5 * voxel - view.T_world_camera[:3, 3]) @ rotation
        inputs = [
            wp.array(pixels.planes, dtype=wp.vec4, device="cpu"),
            wp.array(pixels.weights, dtype=float, device="cpu"),
            wp.array(pixels.free, dtype=float, device="cpu"),
            wp.vec4(*pixels.intrinsics),
            wp.vec3(*first),
            wp.mat33(*(voxel * rotation.T).ravel()),
            TRUNCATION * voxel,
            wp.vec2(DECAY_FROM * voxel, BEHIND * voxel),
            ASSUMED_WEIGHT,
            EDGE_WEIGHT,
        ]
        wp.launch(integrate, dim=counts[:2], inputs=inputs, outputs=[sums, totals, guesses], device="cpu")
    weights = totals.numpy()
    known = weights > 0
    distance = np.divide(sums.numpy(), weights, out=np.ones(shape, dtype=np.float32), where=known)
    guessed = guesses.numpy() > 0.5 * weights if some_assumed else np.zeros(shape, dtype=bool)
    return distance, known, guessed & known


def _empty(
    distance: Float[np.ndarray, "x y z"],
    not_seen: Bool[np.ndarray, "x y z"],
    low: Float[np.ndarray, "3"],
    voxel: float,
    empty: EmptySpace,
) -> None:
    """Give the nodes in and around an empty space at least their distance to its border, from inside."""
    truncation = TRUNCATION * voxel
    around = truncation + empty.unseen_margin
    first = np.clip(np.floor((empty.low - around - low) / voxel), 0, distance.shape).astype(int)
    last = np.clip(np.ceil((empty.high + around - low) / voxel), first, distance.shape).astype(int)
    here = tuple(slice(*ends) for ends in zip(first.tolist(), last.tolist(), strict=True))
    places = low + voxel * (np.indices(distance[here].shape).reshape(3, -1).T + first + 0.5)
    inside = empty.unseen_margin * not_seen[here] - empty.distance(places).reshape(distance[here].shape)
    distance[here] = np.maximum(distance[here], np.clip(inside / truncation, -1.0, 1.0))


def _gaps(known: Bool[np.ndarray, "x y z"], distance: Float[np.ndarray, "x y z"]) -> Bool[np.ndarray, "x y z"]:
    """Return voxels between free ones, in gaps up to GAP wide: rays that dropped out, not things."""
    width = 2 * (GAP // 2) + 1
    free = (known & (distance > 0)).astype(np.uint8)
    closed = minimum_filter(maximum_filter(free, size=width, mode="nearest"), size=width, mode="nearest")
    return (closed > 0) & ~known


def _drop_specks(distance: Float[np.ndarray, "x y z"]) -> None:
    """Turn bodies that float, and bubbles, below SPECK voxels into what surrounds them."""
    for body in (True, False):
        parts, _ = label((distance < 0) == body)
        small = np.bincount(parts.ravel()) < SPECK
        small[0] = False
        distance[small[parts]] = 1.0 if body else -1.0


def _close(distance: Float[np.ndarray, "x y z"]) -> None:
    """Give the margin the mirrored distances, so that a body which the box cuts is closed in the box's faces."""
    for axis in range(3):
        sides = np.moveaxis(distance, axis, 0)
        sides[0], sides[-1] = np.abs(sides[1]), np.abs(sides[-2])


LEAST = 1e-3  # of a value: a vertex stays this far from the ends of its edge, so that no triangle shrinks to a point


def isosurface(
    values: Float[np.ndarray, "x y z"],
) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"], Int[np.ndarray, "vertex 2 3"]]:
    """Return vertices in units of the grid, faces, and the two nodes between which each vertex lies.

    Marching cubes (Lorensen and Cline, SIGGRAPH 1987) by Warp, on the cells that the surface passes only. Normals point
    toward positive values. The surface is closed where it does not leave the grid. The first node of a pair has the lower
    index.
    """
    from warp.geometry import IsoSurfaceMarchingCubes, sparse_marching_cubes_from_cells  # after Warp was made quiet

    inside = values < 0
    every, some = inside, inside
    for axis in range(3):
        lower, upper = [slice(None)] * 3, [slice(None)] * 3
        lower[axis], upper[axis] = slice(None, -1), slice(1, None)
        every = every[tuple(lower)] & every[tuple(upper)]
        some = some[tuple(lower)] | some[tuple(upper)]
    cells = np.argwhere(some & ~every).astype(np.int32)
    if not len(cells):
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32), np.zeros((0, 2, 3), dtype=np.int64)
    corners = cells[:, None] + np.asarray(IsoSurfaceMarchingCubes.CUBE_CORNER_OFFSETS, dtype=np.int32)
    at_corners = values[corners[..., 0], corners[..., 1], corners[..., 2]].astype(np.float32)
    at_corners = np.where(np.abs(at_corners) < LEAST, np.where(at_corners < 0, -LEAST, LEAST), at_corners)
    given = wp.array(at_corners, dtype=wp.float32, device="cpu")
    found, triangles = sparse_marching_cubes_from_cells(cells, given, device="cpu")
    vertices = found.numpy().astype(np.float64)
    nearest = np.rint(vertices).astype(np.int64)
    along, all_of_them = np.abs(vertices - nearest).argmax(axis=1), np.arange(len(vertices))
    nodes = np.stack([nearest, nearest], axis=1)
    nodes[all_of_them, 0, along] = np.floor(vertices[all_of_them, along])
    nodes[all_of_them, 1, along] = nodes[all_of_them, 0, along] + 1
    return vertices, triangles.numpy().reshape(-1, 3), nodes
