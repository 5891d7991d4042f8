"""Surroundings of any kind as convex pieces for MuJoCo's contacts: what is seen of them, a few millimetres deep.

A scan, a sheet or a body that is far from convex has no decomposition into few convex bodies. But hand and object touch only
its surface, near the object's way. So each polygon of that surface becomes a prism that reaches into the solid: planes one
of large rectangles, everything else of triangles, made fewer by quadric error metrics (Garland and Heckbert, 1997). Of what
is too rough for that, what is close to the way keeps most of its triangles, and all prisms are held back from free space.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.ndimage import label
from scipy.spatial import ConvexHull, QhullError

from dexnudge.geometry.exact_distance import ExactDistance, Rays
from dexnudge.scenes.settling import least_heights

Polygon = Float[np.ndarray, "_ 3"]

REACH = 0.5  # [m] around the object's way: a hand with its forearm
AGGRESSION = (3, 7, 10)  # of the simplification, from 0, exact, to 10; the next where one does not reach the number
DEPTH = 0.005  # [m] of a prism: the hand is stopped long before it is half as deep
LEAST_DEPTH = 2.0e-4  # [m] of a prism in a thin board
MOST_PIECES = 4000  # MuJoCo finds the few that matter in a tree
TOLERANCE = 5.0e-4  # [m] that triangles may leave the surface by when they are made fewer
CLOSE = 0.05  # [m] around the way: what hand and object come near to is kept as it is before anything else
CLOSE_SHARE = 0.7  # of the pieces, at most, for that
MOST_OUT = 0.002  # [m] that a piece may reach out of a rough surface: as deep as a hand may be in the surroundings
CRACKS = 0.01  # of a surface's area, by which the normals of a closed one may miss
PLACES = 5  # along the side of a triangle at which that is measured
FEWEST_TRIANGLES = 500  # that are tried first
PERCENT = 99  # of the points within the tolerance; the others lie at corners that are cut off
SAME_PLANE = np.radians(0.2)  # angle between neighbours of a plane
FLATNESS = 5.0e-5  # [m] by which a plane's corners may leave it
SMALLEST_PLANE = 4.0e-4  # [m^2] smaller ones are taken with the rest
FEW_FACES = 4  # of a plane: fewer are taken one by one
CELL = 0.003  # [m] by which a plane's rectangles may fall short of its outline
MOST_CELLS = 300  # along a side of a plane
MOST_RECTANGLES = 32  # of a plane; its other triangles are taken one by one
SMALLEST_RECTANGLE = 25  # cells
SMALL_HOLE = 1.0e-3  # [m^2] of a scan, which is filled
NARROWEST = 1.0e-4  # [m] height of a triangle; a lower one holds nothing
LIFT = 1.0e-4  # [m] from which rays look down on a plane
INSET = 2.0e-5  # [m] below a polygon, where rays begin that look for the other side


@dataclass(frozen=True)
class SurfacePieces:
    """Vertices [m] of convex pieces, and by how much the surface leaves them where triangles were made fewer [m]."""

    pieces: list[Float[np.ndarray, "_ 3"]]
    error: float


def surface_pieces(
    mesh: trimesh.Trimesh,
    way: Float[np.ndarray, "2 3"],
    *,
    most: int = MOST_PIECES,
    within: Float[np.ndarray, "2 3"] | None = None,
) -> SurfacePieces:
    """Return prisms below the surface of `mesh` near a box; they equal it on its free side.

    Args:
        mesh: surroundings [m]; outward normals are on the free side.
        way: corners of the box that holds the object all along its way [m], in the mesh's frame.
        most: pieces at most.
        within: corners of the box of which the surface is taken; None: 0.5 m around the way.
    """
    near = _near(mesh, way + np.array([[-REACH], [REACH]]) if within is None else within)
    if len(near.faces) == 0:
        return SurfacePieces([], 0.0)
    polygons: list[Polygon] = []
    others = np.ones(len(near.faces), dtype=bool)
    for plane in _planes(near):
        filling = _rectangles(near, plane, way)
        polygons.extend(filling)
        others[plane] = ~_covered(near.triangles[plane], filling)
    error = 0.0
    if others.any():
        left = max(most - len(polygons), FEWEST_TRIANGLES)
        rest = trimesh.Trimesh(near.vertices, near.faces[others], process=False)
        fewer, error = _fewer(rest, most=left)
        if error > TOLERANCE:
            fewer, error = _fewer_by_reach(rest, way, most=left)
        polygons.extend(_nearest(np.asarray(fewer.triangles), way, left) if error > TOLERANCE else fewer.triangles)
    pieces = _prisms(polygons, near)
    if error > TOLERANCE and _closed(mesh):
        pieces = _held_back(pieces, ExactDistance(mesh))
    return SurfacePieces(pieces, error)


def _closed(mesh: trimesh.Trimesh) -> bool:
    """Return whether a surface has an inside, but for cracks: the normals of a closed one add up to nothing."""
    cross = np.asarray(mesh.triangles_cross)
    return bool(np.linalg.norm(cross.sum(axis=0)) < CRACKS * np.linalg.norm(cross, axis=1).sum())


def _fewer_by_reach(
    mesh: trimesh.Trimesh, way: Float[np.ndarray, "2 3"], *, most: int
) -> tuple[trimesh.Trimesh, float]:
    """Return the same as `_fewer`, with most of the triangles for what is close to the way."""
    triangles = np.asarray(mesh.triangles)
    close = ((triangles.min(axis=1) <= way[1] + CLOSE) & (triangles.max(axis=1) >= way[0] - CLOSE)).all(axis=1)
    parts, error, left = [], 0.0, most
    for mine, share in ((close, CLOSE_SHARE), (~close, 1.0)):
        if not mine.any():
            continue
        part = trimesh.Trimesh(mesh.vertices, mesh.faces[mine], process=False)
        part.remove_unreferenced_vertices()
        fewer, off = _fewer(part, most=max(int(share * left), 1))
        parts.append(fewer)
        left -= len(fewer.faces)
        error = max(error, off)
    return trimesh.util.concatenate(parts), error


def _nearest(
    triangles: Float[np.ndarray, "face 3 3"], way: Float[np.ndarray, "2 3"], most: int
) -> Float[np.ndarray, "left 3 3"]:
    """Return those nearest to the way, where there are more than `most`."""
    distance = np.maximum(triangles.min(axis=1) - way[1], way[0] - triangles.max(axis=1)).max(axis=1)
    return triangles[np.sort(np.argsort(distance, kind="stable")[:most])]


def _held_back(pieces: list[Polygon], exact: ExactDistance) -> list[Polygon]:
    """Return the prisms on triangles moved into the solid by as much as they reach out of it, and all others as they are.

    What then still reaches out is left out: beside a rough surface, free space matters more than its last crumb.
    """
    planes = [piece for piece in pieces if len(piece) > 6]
    prisms = np.array([piece for piece in pieces if len(piece) == 6]).reshape(-1, 6, 3)
    inward = prisms[:, 3] - prisms[:, 0]
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    for _ in range(2):
        out = _reach_out(prisms[:, :3], exact)
        prisms += np.where(out > TOLERANCE, out, 0.0)[:, None, None] * inward[:, None]
    out = np.maximum(_reach_out(prisms[:, :3], exact), _reach_out(prisms[:, 3:], exact))
    return planes + list(prisms[out <= MOST_OUT])


def _reach_out(triangles: Float[np.ndarray, "n 3 3"], exact: ExactDistance) -> Float[np.ndarray, " n"]:
    """Return how far each triangle reaches out of the solid at most [m], at a lattice of its points."""
    first, second = (part.ravel() for part in np.indices((PLACES + 1, PLACES + 1)))
    share = np.stack([first, second, PLACES - first - second], axis=1)[first + second <= PLACES] / PLACES
    points = np.einsum("pc,ncx->npx", share, triangles).reshape(-1, 3)
    return np.asarray(exact.distances(points).reshape(len(triangles), -1).max(axis=1, initial=0.0))


def _near(mesh: trimesh.Trimesh, box: Float[np.ndarray, "2 3"]) -> trimesh.Trimesh:
    """Return the faces whose bounds meet a box, without those that have no height."""
    triangles = np.asarray(mesh.triangles)
    meets = ((triangles.min(axis=1) <= box[1]) & (triangles.max(axis=1) >= box[0])).all(axis=1)
    meets &= least_heights(triangles) > 0
    near = trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)[meets], process=False)
    near.merge_vertices()
    return near


def _planes(mesh: trimesh.Trimesh) -> list[Int[np.ndarray, " face"]]:
    """Return the connected sets of faces that lie in one plane, largest first."""
    flat = mesh.face_adjacency_angles < SAME_PLANE
    groups = trimesh.graph.connected_components(mesh.face_adjacency[flat], nodes=np.arange(len(mesh.faces)), min_len=2)
    planes = []
    for group in groups:
        normal = np.einsum("f,fx->x", mesh.area_faces[group], mesh.face_normals[group])
        normal /= np.linalg.norm(normal)
        height = mesh.vertices[np.unique(mesh.faces[group])] @ normal
        if np.ptp(height) <= 2 * FLATNESS and mesh.area_faces[group].sum() > SMALLEST_PLANE:
            planes.append(group)
    return sorted(planes, key=lambda group: -float(mesh.area_faces[group].sum()))


def _rectangles(mesh: trimesh.Trimesh, plane: Int[np.ndarray, " face"], way: Float[np.ndarray, "2 3"]) -> list[Polygon]:
    """Return convex polygons that fill most of a plane: its outline where that is convex, else overlapping rectangles."""
    triangles, areas = np.asarray(mesh.triangles[plane]), mesh.area_faces[plane]
    normal = np.einsum("f,fx->x", areas, mesh.face_normals[plane])
    normal /= np.linalg.norm(normal)
    corners = triangles.reshape(-1, 3)
    origin = corners.mean(axis=0)
    axes = _plane_axes(normal)
    flat = (corners - origin) @ axes.T
    try:
        hull = ConvexHull(flat)
    except QhullError:
        return []
    axes = _along_outline(flat[hull.vertices]) @ axes
    flat = (corners - origin) @ axes.T
    if hull.volume - areas.sum() <= TOLERANCE * hull.area:
        return [origin + flat[hull.vertices] @ axes]
    if len(plane) < FEW_FACES:
        return []
    low, size = flat.min(axis=0), np.ptp(flat, axis=0)
    cell = max(CELL, float(size.max()) / MOST_CELLS)
    counts = np.maximum(np.floor(size / cell).astype(int), 1)
    grid = np.stack(np.meshgrid(*(np.arange(count + 1) for count in counts), indexing="ij"), axis=-1)
    points = origin + (low + cell * grid.reshape(-1, 2)) @ axes + LIFT * normal
    own = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    hit = (Rays(own)(points, -normal, reach=2 * LIFT) < 1.5 * LIFT).reshape(counts + 1)
    full = _without_small_holes(hit[:-1, :-1] & hit[1:, :-1] & hit[:-1, 1:] & hit[1:, 1:], cell)
    seen = (way - origin) @ axes.T
    mine = np.abs((way - origin) @ normal).min() < REACH
    first = np.floor((np.stack([seen.min(axis=0), seen.max(axis=0)]) - low) / cell).astype(int) if mine else None
    found = _cover(full, first)
    return [origin + (low + cell * np.array([[a, b], [c, b], [c, d], [a, d]])) @ axes for (a, b), (c, d) in found]


def _plane_axes(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    """Return two unit axes that span the plane with this normal."""
    along = np.eye(3)[np.argsort(np.abs(normal), kind="stable")[0]]
    first = along - (along @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def _along_outline(outline: Float[np.ndarray, "corner 2"]) -> Float[np.ndarray, "2 2"]:
    """Return the axes of the smallest rectangle around a convex outline, one of which lies along one of its sides."""
    along = np.roll(outline, -1, axis=0) - outline
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    turns = np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=1)
    size = np.ptp(np.einsum("sax,cx->sac", turns, outline), axis=2)
    return np.asarray(turns[size.prod(axis=1).argmin()])


def _without_small_holes(full: Bool[np.ndarray, "x y"], cell: float) -> Bool[np.ndarray, "x y"]:
    hole, count = label(~np.pad(full, 1))
    small = np.bincount(hole.ravel(), minlength=count + 1) * cell**2 <= SMALL_HOLE
    small[[0, hole[0, 0]]] = False  # what is full, and what is outside
    return np.asarray(full | small[hole[1:-1, 1:-1]])


Corners = tuple[tuple[int, int], tuple[int, int]]  # of a rectangle of cells: first, last + 1


def _cover(full: Bool[np.ndarray, "x y"], first: Int[np.ndarray, "2 2"] | None) -> list[Corners]:
    """Return rectangles of full cells that overlap and together hold most of them.

    The first one is grown from the part of the object's way that is full, so that nothing slides over its borders.
    """
    found: list[Corners] = []
    free = full.copy()
    if first is not None:
        (a, b), (c, d) = np.clip(first[0], 0, full.shape), np.clip(first[1] + 1, 0, full.shape)
        ((e, f), (g, h)), size = _largest_rectangle(full[a:c, b:d])
        if size > 0:
            found.append(_grown(full, ((int(a + e), int(b + f)), (int(a + g), int(b + h)))))
            _mark(free, found[-1])
    while len(found) < MOST_RECTANGLES:
        corners, size = _largest_rectangle(free)
        if size < SMALLEST_RECTANGLE:
            break
        found.append(_grown(full, corners))
        _mark(free, found[-1])
    return found


def _mark(free: Bool[np.ndarray, "x y"], corners: Corners) -> None:
    (a, b), (c, d) = corners
    free[a:c, b:d] = False


def _grown(full: Bool[np.ndarray, "x y"], corners: Corners) -> Corners:
    """Return the rectangle with its sides moved outward as long as it holds full cells only."""
    (a, b), (c, d) = corners
    moved = True
    while moved:
        moved = False
        if a > 0 and full[a - 1, b:d].all():
            a, moved = a - 1, True
        if c < full.shape[0] and full[c, b:d].all():
            c, moved = c + 1, True
        if b > 0 and full[a:c, b - 1].all():
            b, moved = b - 1, True
        if d < full.shape[1] and full[a:c, d].all():
            d, moved = d + 1, True
    return (a, b), (c, d)


def _largest_rectangle(free: Bool[np.ndarray, "x y"]) -> tuple[Corners, int]:
    """Return the largest rectangle of true cells and its size: the largest one below the histogram of each row."""
    best, corners = 0, ((0, 0), (0, 0))
    height = np.zeros(free.shape[1] + 1, dtype=int)
    for row, cells in enumerate(free):
        height[:-1] = np.where(cells, height[:-1] + 1, 0)
        stack: list[int] = []
        columns = height.tolist()
        for column, value in enumerate(columns):
            while stack and columns[stack[-1]] >= value:
                top = columns[stack.pop()]
                left = stack[-1] + 1 if stack else 0
                if top * (column - left) > best:
                    best = top * (column - left)
                    corners = ((row + 1 - top, left), (row + 1, column))
            stack.append(column)
    return corners, best


def _covered(triangles: Float[np.ndarray, "face 3 3"], polygons: list[Polygon]) -> Bool[np.ndarray, " face"]:
    """Return which triangles lie within one of the polygons, to the tolerance of a plane."""
    covered = np.zeros(len(triangles), dtype=bool)
    for corners in polygons:
        centre = corners.mean(axis=0)
        along = np.roll(corners, -1, axis=0) - corners
        normal = _normal(corners)
        side = np.cross(along, normal)
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        side *= np.sign(np.einsum("ex,ex->e", side, corners - centre))[:, None]
        offset = triangles - centre
        beyond = (np.einsum("fcx,ex->fce", offset, side) - np.einsum("ex,ex->e", side, corners - centre)).max(
            axis=(1, 2)
        )
        covered |= (beyond <= TOLERANCE) & (np.abs(offset @ normal).max(axis=1) <= 2 * FLATNESS)
    return covered


def _fewer(mesh: trimesh.Trimesh, *, most: int) -> tuple[trimesh.Trimesh, float]:
    """Return (as few triangles as keep to the mesh within the tolerance, at most `most`; how far they leave it [m])."""
    import fast_simplification

    if len(mesh.faces) <= min(FEWEST_TRIANGLES, most):
        return mesh, 0.0
    points = np.asarray(mesh.triangles_center)
    mesh = _with_border(mesh)
    wanted = min(FEWEST_TRIANGLES, most)
    while wanted < min(2 * most, len(mesh.faces)):
        wanted = min(wanted, most)
        for aggression in AGGRESSION:
            vertices, faces = fast_simplification.simplify(
                np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32), target_count=wanted, agg=aggression
            )
            if len(faces) <= wanted:
                break
        fewer = trimesh.Trimesh(vertices, faces, process=False)
        error = float(np.percentile(ExactDistance(fewer).distances(points, signed=False), PERCENT))
        if error <= TOLERANCE or wanted == most:
            return fewer, error
        wanted *= 2
    return mesh, 0.0


def _with_border(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the surface with its borders turned down as far as prisms reach: what folds is kept, what ends is eaten up."""
    mesh.merge_vertices()
    edges = np.asarray(mesh.edges)
    border = edges[trimesh.grouping.group_rows(np.sort(edges, axis=1), require_count=1)]
    corners, place = np.unique(border, return_inverse=True)
    start, end = place.reshape(-1, 2).T + len(mesh.vertices)
    down = np.asarray(mesh.vertices[corners] - DEPTH * mesh.vertex_normals[corners])
    skirt = np.concatenate(
        [np.stack([border[:, 1], border[:, 0], start], axis=1), np.stack([border[:, 1], start, end], axis=1)]
    )
    return trimesh.Trimesh(np.concatenate([mesh.vertices, down]), np.concatenate([mesh.faces, skirt]), process=False)


def _prisms(polygons: list[Polygon], mesh: trimesh.Trimesh) -> list[Float[np.ndarray, "_ 3"]]:
    """Return each polygon with a copy of it below; less deep where the surface's other side is near."""
    kept = [corners for corners in polygons if len(corners) > 3 or least_heights(corners[None])[0] > NARROWEST]
    normals = np.stack([_normal(corners) for corners in kept])
    count = np.array([len(corners) for corners in kept])
    owner = np.repeat(np.arange(len(kept)), count + 1)
    centres = np.array([corners.mean(axis=0) for corners in kept])
    starts = np.concatenate(
        [
            np.concatenate([0.9 * corners + 0.1 * centre, centre[None]])
            for corners, centre in zip(kept, centres, strict=True)
        ]
    )
    inward = -normals[owner]
    way = Rays(mesh).first_hits(starts + INSET * inward, inward, reach=DEPTH)[0] + INSET
    depth = np.full(len(kept), DEPTH)
    np.minimum.at(depth, owner, way)
    depth = np.maximum(depth, LEAST_DEPTH)
    return [
        np.concatenate([corners, corners - deep * normal])
        for corners, normal, deep in zip(kept, normals, depth, strict=True)
    ]


def _normal(corners: Polygon) -> Float[np.ndarray, "3"]:
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[1])
    return np.asarray(normal / np.linalg.norm(normal))
