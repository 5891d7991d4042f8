"""Links, objects and surroundings as convex pieces with few vertices, which is what MuJoCo's contacts are made of.

A link counts as its convex hull, as in most simulations of hands, unless the hull fills a hollow such as the palm's. Of the
surroundings, convex parts are taken as they stand; closed ones of few triangles are cut by CoACD, and the result is measured
against the part; of everything else the surface is taken.
"""

import logging
from typing import Any, TypeAlias

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from dexnudge.errors import MeshError
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.mesh_repair import without_small_holes
from dexnudge.geometry.surface_points import surface_points
from dexnudge.hands.hand import Hand
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.simulation.decomposition import coacd_pieces
from dexnudge.simulation.surface_pieces import MOST_PIECES, surface_pieces

CONVEX_ENOUGH = 0.99  # volume / volume of the hull: an edge may be hollow, a camera's bump may not be ramped
MOST_BODIES = 64  # a mesh of more closed bodies than this is a soup of parts, and is decomposed as a whole
THINNEST_PIECE = 1.0e-9  # of the longest side cubed; a thinner piece is flat
TOLERANCE = 1.0e-4  # [m] that a piece may leave out of its hull: rounded edges need no more vertices than that
LINK_TOLERANCE = 2.0e-4  # [m] the same for links; a fifth of the penetration that is allowed
ONE_BY_ONE = 200  # vertices of a hull; each costs a hull of those before, 900 of an upper arm a minute
HOLLOW = 0.7  # volume / volume of the hull below which a link is cut: the palm's hull fills the hollow of the hand
THINNEST_PART = 1.0e-4  # [m] mean thickness of a part of the surroundings; a thinner one is a sheet
MOST_FACES_SPLIT = 100_000  # of surroundings that are looked at part by part; a larger mesh is a scan
MOST_FACES_CUT = 2_000  # of a part that CoACD cuts, in seconds; more take it minutes
TOLERANCE_OF_SURFACE = 0.001  # [m] from which it is said that pieces leave the surface
MOST_ADDED = 0.002  # [m] that pieces may reach out of their part: as deep as a hand may be in the surroundings
CHECK_SPACING = 0.005  # [m] between the points at which that is measured
SURFACE_SAMPLES = 1000  # on which CoACD measures concavity
LONGEST_SEARCH = 120.0  # [s] of CoACD for an object
LONGEST_SEARCH_AROUND = 30.0  # [s] for a part of the surroundings, whose surface is taken instead
VOXELS_OF_OPEN_MESH = 100  # along the longest side: an open mesh is first closed on a grid


def simple_hull(points: Float[np.ndarray, "point 3"], *, tolerance: float) -> Float[np.ndarray, "vertex 3"]:
    """Return some of the points, whose hull leaves out at most `tolerance` [m] of the hull of all.

    Points are added where they lie farthest outside the hull of those before (quickhull's rule, Barber et al., 1996, stopped
    early): one by one, and of large round bodies, which need hundreds, then one for each face.
    """
    vertices = points[ConvexHull(points).vertices]
    chosen = _first_body(vertices)
    while True:
        equations = ConvexHull(vertices[chosen]).equations
        outside = vertices @ equations[:, :3].T + equations[:, 3]
        if outside.max() <= tolerance:
            return vertices[chosen]
        if len(chosen) < ONE_BY_ONE:
            chosen.append(int(outside.max(axis=1).argmax()))
        else:
            chosen += np.unique(outside.argmax(axis=0)[outside.max(axis=0) > tolerance]).tolist()


def _first_body(vertices: Float[np.ndarray, "vertex 3"]) -> list[int]:
    """Return indices of four vertices that span a volume: each is farthest from the point, line or plane before it."""
    chosen = [int(vertices[:, 0].argmin())]
    offset = vertices - vertices[chosen[0]]
    for _ in range(3):
        chosen.append(int(np.linalg.norm(offset, axis=1).argmax()))
        direction = offset[chosen[-1]] / np.linalg.norm(offset[chosen[-1]])
        offset = offset - np.outer(offset @ direction, direction)
    return chosen


# How finely CoACD cuts (of half the longest side), into how many pieces at most (-1: any number), and how long it searches
# for each cut (its own values are 150, 20 and 3).
SEARCH = {"mcts_iterations": 60, "mcts_nodes": 10, "mcts_max_depth": 3}
DECOMPOSE_OBJECT = SEARCH | {"threshold": 0.02, "max_convex_hull": 12}  # 1.5 mm on a phone
DECOMPOSE_LINK = {"threshold": 0.06, "mcts_iterations": 20, "mcts_nodes": 6, "mcts_max_depth": 2}  # 3 mm on a palm
DECOMPOSE_ENVIRONMENT = SEARCH | {"threshold": 0.01}  # the finest cuts

Vertices: TypeAlias = Float[np.ndarray, "_ 3"]


@cached_per_instance
def object_pieces(mesh: trimesh.Trimesh) -> list[Vertices]:
    """Return the vertices [m, mesh frame] of convex pieces that together are the object; remembered per mesh.

    Raises:
        MeshError: the mesh cannot be decomposed.
    """
    pieces: list[Vertices] = []
    for body in bodies_of(without_small_holes(mesh)):  # an open one takes CoACD minutes
        convex = body.is_watertight and body.volume > CONVEX_ENOUGH * body.convex_hull.volume
        pieces.extend([np.asarray(body.convex_hull.vertices)] if convex else decomposed(body, DECOMPOSE_OBJECT))
    return [simple_hull(piece, tolerance=TOLERANCE) for piece in pieces]


def bodies_of(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """Return the closed bodies of a mesh, or the whole mesh where they are too many or not all closed."""
    if not 1 < mesh.body_count <= MOST_BODIES:
        return [mesh]
    bodies = list(mesh.split(only_watertight=False))
    return bodies if all(body.is_watertight and body.volume > 0 for body in bodies) else [mesh]


def decomposed(
    mesh: trimesh.Trimesh, settings: dict[str, Any], *, limit: float = LONGEST_SEARCH, what: str = "the object"
) -> list[Vertices]:
    """Return the vertices [m, mesh frame] of CoACD's pieces; `what` is cut, for messages.

    Raises:
        MeshError: there are none, or none after `limit` [s].
    """
    try:
        found = coacd_pieces(
            np.asarray(mesh.vertices, dtype=np.float64),
            np.asarray(mesh.faces, dtype=np.int32),
            {
                "preprocess_mode": "off" if mesh.is_watertight else "on",
                "preprocess_resolution": VOXELS_OF_OPEN_MESH,
                "resolution": SURFACE_SAMPLES,
                "seed": 0,
                **settings,
            },
            limit=limit,
        )
    except TimeoutError as error:
        raise MeshError(
            f"{what} with {len(mesh.faces):,} triangles was not cut into convex pieces within {limit:g} s; expected a "
            "closed body of few triangles; close its holes, or decimate it to some thousands of triangles "
            "(in MeshLab: Simplification: Quadric Edge Collapse Decimation)"
        ) from error
    except ValueError as error:
        raise MeshError(
            f"{what} with {len(mesh.faces):,} triangles could not be cut into convex pieces ({error}); expected a "
            "closed body; close its holes or remesh it"
        ) from error
    thinnest = THINNEST_PIECE * float(mesh.extents.max()) ** 3
    pieces = [vertices for vertices in found if _hull_volume(vertices) > thinnest]
    if not pieces:
        raise MeshError(
            f"{what} with {len(mesh.faces)} triangles could not be cut into convex pieces: CoACD returned "
            f"{len(found)}, none of them with a volume; expected a body with a thickness; close its holes or remesh it"
        )
    return pieces


def _hull_volume(vertices: Vertices) -> float:
    try:
        return float(ConvexHull(vertices).volume)
    except QhullError:
        return 0.0


def link_pieces(hand: Hand) -> list[list[Vertices]]:
    """Return the convex pieces of every link [m, link frame]; remembered per mesh, since a hollow palm takes seconds."""
    return [_pieces_of_link(mesh, name) for name, mesh in zip(hand.link_names, hand.link_meshes, strict=True)]


@cached_per_instance
def _pieces_of_link(mesh: trimesh.Trimesh, name: str) -> list[Vertices]:
    if len(mesh.faces) == 0:
        return []
    found: list[Vertices] = []
    hull = mesh.convex_hull
    bodies = [body for body in bodies_of(mesh) if body.is_watertight]
    if mesh.volume < HOLLOW * hull.volume and bodies:
        for body in bodies:
            full = body.volume > HOLLOW * body.convex_hull.volume
            found.extend(
                [np.asarray(body.vertices)] if full else decomposed(body, DECOMPOSE_LINK, what=f"link '{name}'")
            )
    else:
        found.append(np.asarray(hull.vertices))
    return [simple_hull(vertices, tolerance=LINK_TOLERANCE) for vertices in found]


def environment_pieces(
    mesh: trimesh.Trimesh, way: Float[np.ndarray, "2 3"], *, within: Float[np.ndarray, "2 3"] | None = None
) -> list[Vertices]:
    """Return the vertices [m, world] of convex pieces that together are the surroundings.

    Convex parts are taken as they are, other closed ones of few triangles are cut by CoACD. Sheets, scans and what convex
    pieces do not describe to 2 mm is taken as its surface near the object's way; see `surface_pieces`.

    Args:
        mesh: surroundings [m, world].
        way: corners of the box that holds the object all along its way [m, world].
        within: corners of the box outside of which surfaces are left out [m, world]; None: as far as a hand reaches.
    """
    parts = list(mesh.split(only_watertight=False)) if len(mesh.faces) <= MOST_FACES_SPLIT else [mesh]
    pieces: list[Vertices] = []
    others: list[trimesh.Trimesh] = []
    for part in map(without_small_holes, parts):
        found = _piece_of_convex_body(part)
        pieces.extend(found)
        if not found:
            others.append(part)
    if all(len(part.faces) <= MOST_FACES_CUT for part in others):  # the crumbs and hollows of a scan are no bodies
        cut = [_pieces_of_body(part) for part in others]
        pieces.extend(piece for found in cut for piece in found)
        others = [part for part, found in zip(others, cut, strict=True) if not found]
    if others:
        surface = surface_pieces(
            trimesh.util.concatenate(others), way, most=max(MOST_PIECES - len(pieces), 1), within=within
        )
        pieces.extend(surface.pieces)
        if surface.error > TOLERANCE_OF_SURFACE:
            logging.getLogger(__name__).warning(
                "the surroundings are simulated as %d pieces, which leave their surface by up to %.1f mm",
                len(surface.pieces),
                1e3 * surface.error,
            )
    return pieces


def _is_body(part: trimesh.Trimesh) -> bool:
    """Return whether a part is closed, and neither a hollow nor a sheet."""
    thinnest = THINNEST_PART * float(np.sort(part.extents)[1:].prod())
    return bool(part.is_watertight and part.volume > 0 and _hull_volume(part.vertices) >= thinnest)


def _piece_of_convex_body(part: trimesh.Trimesh) -> list[Vertices]:
    """Return the one piece of a closed body that is convex; none for any other part."""
    if not _is_body(part) or part.volume <= CONVEX_ENOUGH * _hull_volume(part.vertices):
        return []
    return [simple_hull(np.asarray(part.vertices), tolerance=TOLERANCE)]


def _pieces_of_body(part: trimesh.Trimesh) -> list[Vertices]:
    """Return the convex pieces of a closed body; none where there are none that describe it to 2 mm."""
    if not _is_body(part):
        return []
    try:
        cut = decomposed(part, DECOMPOSE_ENVIRONMENT, limit=LONGEST_SEARCH_AROUND)
        found = [simple_hull(piece, tolerance=TOLERANCE) for piece in cut]
    except (MeshError, QhullError):
        return []
    return found if _reach_out(part, found) <= MOST_ADDED else []


def _reach_out(part: trimesh.Trimesh, pieces: list[Vertices]) -> float:
    """Return how far the pieces reach out of the part [m], measured at points of their surfaces."""
    hulls = [trimesh.convex.convex_hull(piece) for piece in pieces]
    points = np.concatenate([surface_points(hull, spacing=CHECK_SPACING).points for hull in hulls])
    return float(ExactDistance(part).distances(points).max())
