"""Repairs of meshes as scanners and CAD programs write them; those in place return what they did in a sentence.

A mesh that needs none of them leaves as it came, bit by bit.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_lattice import distinct_rows

SPECK_SIZE = 0.05  # of the largest part's longest side: what is longer is no speck
SPECK_GAP = 1e-3  # of the same: a small part this near belongs to the object, as a key or a foot does
FACING_UP = 0.1  # z of the normal from which a face can carry something
WIDE_OPEN = 0.2  # length of the sum of a part's normals, by area, over its area: 0 where closed, 1 of a flat sheet
FLAT = 1e-9  # of the longest side cubed; a smaller volume has no sign
HOLE_EDGES, HOLE_SIZE = 30, 0.25  # a hole with more edges, or longer than this part of the longest side, may be meant


def parts(corners: Int[np.ndarray, "face 3"]) -> Int[np.ndarray, " face"]:
    """Return the number of the connected part that each face belongs to; faces with a common corner are connected."""
    count = int(corners.max()) + 1
    links = coo_array(
        (np.ones(2 * len(corners)), (np.tile(corners[:, 0], 2), corners[:, 1:].T.ravel())), shape=(count, count)
    )
    part = connected_components(links, directed=False)[1][corners[:, 0]]
    return np.unique(part, return_inverse=True)[1].astype(np.int64)  # a corner of no face has no part


def part_bounds(
    triangles: Float[np.ndarray, "face 3 3"], part: Int[np.ndarray, " face"]
) -> tuple[Float[np.ndarray, "part 3"], Float[np.ndarray, "part 3"]]:
    """Return the lower and the upper corner of the box around each part [the triangles' unit]."""
    order = np.argsort(part, kind="stable")
    begins = np.cumsum(np.bincount(part)) - np.bincount(part)
    low = np.minimum.reduceat(triangles.min(axis=1)[order], begins)
    return low, np.maximum.reduceat(triangles.max(axis=1)[order], begins)


def drop_doubled_faces(mesh: trimesh.Trimesh) -> str | None:
    """Keep one of each set of faces with the same three corners: a two-sided surface has no inside.

    Of closed parts, which may touch each other in a face, only whole ones are dropped.
    """
    corners = distinct_rows(np.asarray(mesh.vertices))[1][mesh.faces]
    first = distinct_rows(np.sort(corners, axis=1))[0]
    extra = np.ones(len(corners), dtype=bool)
    extra[first] = False
    if extra.any() and mesh.is_watertight:
        part = parts(np.asarray(mesh.faces))
        whole = np.ones(part.max() + 1, dtype=bool)
        np.logical_and.at(whole, part, extra)
        extra &= whole[part]
    if not extra.any():
        return None
    mesh.update_faces(~extra)
    return f"{np.count_nonzero(extra)} of {len(corners)} faces stood there twice and count once"


def drop_specks(mesh: trimesh.Trimesh) -> str | None:
    """Leave out small parts that stand apart from the rest, such as the noise of a scan."""
    vertices = np.asarray(mesh.vertices)
    corners = distinct_rows(vertices)[1][mesh.faces]
    part = parts(corners)
    count = int(part.max()) + 1
    if count == 1:
        return None
    low, high = part_bounds(np.asarray(mesh.triangles), part)
    size = (high - low).max(axis=1)
    main = size.max()
    small = size <= SPECK_SIZE * main
    if not small.any() or small.all():
        return None
    rest = trimesh.Trimesh(vertices, np.asarray(mesh.faces)[~small[part]], process=False)
    rest.remove_unreferenced_vertices()
    mine = small[part]
    distance = ExactDistance(rest).to_surface(vertices[mesh.faces[mine]].reshape(-1, 3)).distance
    gap = np.full(count, np.inf)
    np.minimum.at(gap, np.repeat(part[mine], 3), distance)
    speck = small & (gap > SPECK_GAP * main)
    if not speck.any():
        return None
    mesh.update_faces(~speck[part])
    left_out = np.count_nonzero(speck)
    which = "1 small part that stands" if left_out == 1 else f"{left_out} small parts that stand"
    return (
        f"{which} apart from the rest {'was' if left_out == 1 else 'were'} left out "
        f"(the largest {100 * size[speck].max() / main:.1f} % of the object's length)"
    )


def wind_outward(mesh: trimesh.Trimesh, *, surroundings: bool) -> list[str]:
    """Turn faces round that disagree with their neighbours, and bodies that are inside out.

    A closed body inside the bounds of another one is taken for a hollow and stays. A wide open part of surroundings has no
    volume and stays as it is, but some face of surroundings must face up, or nothing could lie there.
    """
    notes = []
    repaired = not mesh.is_winding_consistent
    if repaired:
        odd = _against_neighbours(mesh)
        _turn_round(mesh, odd)
        notes.append(_noted(odd, "{} faces were wound against their neighbours and were turned round"))
    if surroundings and not mesh.is_watertight:
        inverted = _inverted_parts(mesh, also_open=True) & ~_wide_open(mesh)
    else:
        # An open mesh has a volume only relative to a point: its centre is the one that treats all sides alike.
        if _volumes(mesh.triangles - mesh.bounds.mean(axis=0)).sum() < -FLAT * float(mesh.extents.max()) ** 3:
            _turn_round(mesh, np.ones(len(mesh.faces), dtype=bool))
            notes.append("the mesh was inside out and was turned round")
        inverted = _inverted_parts(mesh, also_open=repaired)
    if inverted.any():
        _turn_round(mesh, inverted)
        notes.append(_noted(inverted, "parts of {} faces were inside out and were turned round"))
    up = mesh.face_normals[:, 2]
    if surroundings and not mesh.is_watertight and up.max() < FACING_UP and up.min() < -FACING_UP:
        _turn_round(mesh, np.ones(len(mesh.faces), dtype=bool))
        notes.append("every face faced down: turned round, so that something can lie on it")
    if not mesh.is_winding_consistent:
        notes.append("some faces still disagree about the outside: depths near them may be wrong")
    return notes


def _turn_round(mesh: trimesh.Trimesh, turned: Bool[np.ndarray, " face"]) -> None:
    """Reverse the winding of some faces; `Trimesh.invert` may leave their normals as they were."""
    faces = np.array(mesh.faces)
    faces[turned] = faces[turned][:, ::-1]
    mesh.faces = faces


def _against_neighbours(mesh: trimesh.Trimesh) -> Bool[np.ndarray, " face"]:
    """Return the faces to turn round so that neighbours agree: the fewer ones of each connected part."""
    faces, pairs = np.asarray(mesh.faces), np.asarray(mesh.face_adjacency)
    start, end = np.asarray(mesh.face_adjacency_edges).T[:, :, None]
    along = [(faces[side] == start) & (np.roll(faces[side], -1, axis=1) == end) for side in pairs.T]
    agree = along[0].any(axis=1) != along[1].any(axis=1)
    count = len(faces)
    part = connected_components(coo_array((np.ones(len(pairs)), pairs.T), shape=(count, count)), directed=False)[1]
    roots = np.unique(part, return_index=True)[1]
    # One more node, joined to a face of each part, so that a single search reaches all.
    ends = np.concatenate([pairs, np.stack([roots, np.full(len(roots), count)], axis=1)])
    weight = np.concatenate([np.where(agree, 1.0, 2.0), np.ones(len(roots))])
    graph = coo_array((np.tile(weight, 2), (ends.ravel("F"), ends[:, ::-1].ravel("F"))), shape=(count + 1,) * 2).tocsr()
    order, above = breadth_first_order(graph, count, directed=False)
    step = np.asarray(graph[order[1:], above[order[1:]]]).ravel() == 2.0
    odd = np.zeros(count + 1, dtype=bool)
    odd[order[1:]] = step
    above[count] = count
    while (above != count).any():  # each round doubles how far up the tree a face has looked
        odd ^= odd[above]
        above = above[above]
    share = np.bincount(part, odd[:count]) / np.bincount(part)
    return np.asarray(odd[:count] != (share > 0.5)[part])


def turned_toward(mesh: trimesh.Trimesh, point: Float[np.ndarray, "3"]) -> trimesh.Trimesh:
    """Return surroundings whose wide open parts face a point [m]: the object stands before a sheet, not behind it.

    What decides is the solid angle under which the point sees the part's outer side, less that of its inner side.
    """
    if mesh.is_watertight:
        return mesh
    part = parts(np.asarray(mesh.faces))
    wrong = (np.bincount(part, solid_angles(np.asarray(mesh.triangles) - point)) > 0)[part] & _wide_open(mesh)
    if not wrong.any():
        return mesh
    turned = mesh.copy()
    _turn_round(turned, wrong)
    note = _noted(wrong, "open parts of {} faces had their back to the object and were turned round")
    turned.metadata["notes"] = [*mesh.metadata.get("notes", ()), note]
    return turned


def _noted(which: Bool[np.ndarray, " f"], text: str) -> str:
    """Return the note with the number of faces, in the singular where it is one."""
    number = np.count_nonzero(which)
    if number == 1:
        for many, one in (("parts", "a part"), ("faces", "face"), ("were", "was"), ("their", "its")):
            text = text.replace(many, one)
    return text.format(f"{number:,}")


def solid_angles(corners: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, " n"]:
    """Return the solid angle [sr] of triangles seen from the origin, positive from behind (Van Oosterom, Strackee, 1983)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    na, nb, nc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    return np.asarray(2 * np.arctan2(_volumes(corners), na * nb * nc + ab * nc + bc * na + ca * nb))


def _wide_open(mesh: trimesh.Trimesh) -> Bool[np.ndarray, " face"]:
    """Return the faces of parts that enclose little: the sum of their normals is long."""
    part, cross = parts(np.asarray(mesh.faces)), np.asarray(mesh.triangles_cross)
    net = np.stack([np.bincount(part, column) for column in cross.T], axis=1)
    area = np.bincount(part, np.linalg.norm(cross, axis=1))
    return np.asarray((np.linalg.norm(net, axis=1) > WIDE_OPEN * area)[part])


def _inverted_parts(mesh: trimesh.Trimesh, *, also_open: bool) -> Bool[np.ndarray, " face"]:
    """Return the faces of parts with a negative volume; open parts only where `also_open`."""
    part = parts(np.asarray(mesh.faces))
    count = int(part.max()) + 1
    if count == 1 and not also_open:
        return np.zeros(len(part), dtype=bool)
    triangles = np.asarray(mesh.triangles)
    edges = np.bincount(part[mesh.face_adjacency[:, 0]], minlength=count)
    closed = 2 * edges == 3 * np.bincount(part)
    low, high = part_bounds(triangles, part)
    volume = np.bincount(part, _volumes(triangles - ((low + high) / 2)[part][:, None]), minlength=count)
    inverted = (closed | also_open) & (volume < -FLAT * (high - low).max(axis=1) ** 3)
    for index in np.flatnonzero(inverted & closed):
        around = (low <= low[index]).all(axis=1) & (high >= high[index]).all(axis=1)
        inverted[index] = np.count_nonzero(around) == 1
    return np.asarray(inverted[part])


def _volumes(triangles: np.ndarray) -> np.ndarray:
    """Return six times the signed volume between each of the triangles (n, 3, 3) and the origin."""
    return np.einsum("ij,ij->i", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2]))


def without_small_holes(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the mesh with holes of at most 30 edges and a quarter of the longest side closed by triangles.

    They meet at the middle of each hole. For what needs a closed body, such as a convex decomposition; distances do not.
    """
    if mesh.is_watertight:
        return mesh
    edges = np.asarray(mesh.edges)
    border = edges[trimesh.grouping.group_rows(np.sort(edges, axis=1), require_count=1)]
    follows: dict[int, list[int]] = {}
    for start, end in border[:, ::-1].tolist():  # along the new faces, against the mesh's own
        follows.setdefault(start, []).append(end)
    vertices, faces = [np.asarray(mesh.vertices)], [np.asarray(mesh.faces)]
    for start in list(follows):
        path = [start]
        while follows.get(path[-1]):
            following = follows[path[-1]].pop()
            if following not in path:
                path.append(following)
                continue
            loop = path[path.index(following) :]
            del path[path.index(following) + 1 :]
            corners = np.asarray(mesh.vertices)[loop]
            if len(loop) <= HOLE_EDGES and np.ptp(corners, axis=0).max() <= HOLE_SIZE * mesh.extents.max():
                centre = sum(map(len, vertices))
                vertices.append(corners.mean(axis=0, keepdims=True))
                faces.append(np.array([[one, other, centre] for one, other in pairwise([*loop, loop[0]])]))
    return mesh if len(faces) == 1 else trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
