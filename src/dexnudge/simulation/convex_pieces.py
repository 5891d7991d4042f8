"""The hand's links as convex bodies with few vertices: MuJoCo's contacts are between convex bodies, and small ones are fast.

A link counts as its convex hull, as in most simulations of hands; only a link whose hull reaches far outside it, as the
hull over the hollow of a palm does, is cut into several.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from dexnudge.errors import MeshError
from dexnudge.hands.hand import Hand
from dexnudge.jobs.cached import cached_per_instance


def simple_hull(points: Float[np.ndarray, "point 3"], *, tolerance: float) -> Float[np.ndarray, "vertex 3"]:
    """Some of the points, whose hull leaves out at most `tolerance` [m] of the hull of all.

    Points are added one by one where they lie farthest outside the hull of those before (quickhull's rule, Barber et
    al., 1996, stopped early).
    """
    vertices = points[ConvexHull(points).vertices]
    chosen = _first_body(vertices)
    while True:
        equations = ConvexHull(vertices[chosen]).equations
        outside = (vertices @ equations[:, :3].T + equations[:, 3]).max(axis=1)
        if outside.max() <= tolerance:
            return vertices[chosen]
        chosen.append(int(outside.argmax()))


def _first_body(vertices: Float[np.ndarray, "vertex 3"]) -> list[int]:
    """Indices of four vertices that span a volume: each is farthest from the point, line or plane of those before."""
    chosen = [int(vertices[:, 0].argmin())]
    offset = vertices - vertices[chosen[0]]
    for _ in range(3):
        chosen.append(int(np.linalg.norm(offset, axis=1).argmax()))
        direction = offset[chosen[-1]] / np.linalg.norm(offset[chosen[-1]])
        offset = offset - np.outer(offset @ direction, direction)
    return chosen


CONVEX_ENOUGH = 0.99  # volume / volume of the hull: an edge may be hollow, a camera's bump may not be ramped
MOST_BODIES = 64  # a mesh of more closed bodies than this is a soup of parts, and is decomposed as a whole
THINNEST_PIECE = 1.0e-9  # of the longest side cubed; a thinner piece is flat
TOLERANCE = 1.0e-4  # [m] that a piece may leave out of its hull: rounded edges need no more vertices than that
SURFACE_SAMPLES = 1000  # on which CoACD measures concavity
VOXELS_OF_OPEN_MESH = 100  # along the longest side: an open mesh is first closed on a grid


@dataclass(frozen=True)
class Decomposition:
    """How finely CoACD cuts, and how long it searches for each cut (its own values are 150, 20 and 3).

    concavity: of half the longest side. pieces: the most that there may be, -1 for any number.
    """

    concavity: float
    pieces: int
    iterations: int
    nodes: int
    depth: int


DECOMPOSE_OBJECT = Decomposition(concavity=0.02, pieces=12, iterations=60, nodes=10, depth=3)  # 1.5 mm on a phone
DECOMPOSE_LINK = Decomposition(concavity=0.06, pieces=-1, iterations=20, nodes=6, depth=2)  # 3 mm on a palm


def convex_pieces(mesh: trimesh.Trimesh) -> list[Float[np.ndarray, "_ 3"]]:
    """Vertices [m, mesh frame] of convex bodies that together are the object.

    Raises:
        MeshError: when the mesh cannot be decomposed.
    """
    pieces: list[Float[np.ndarray, "_ 3"]] = []
    for body in bodies_of(mesh):
        convex = body.is_watertight and body.volume > CONVEX_ENOUGH * body.convex_hull.volume
        pieces.extend([np.asarray(body.convex_hull.vertices)] if convex else decomposed(body, DECOMPOSE_OBJECT))
    return [simple_hull(piece, tolerance=TOLERANCE) for piece in pieces]


def bodies_of(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """The closed bodies of a mesh, or the whole mesh where they are too many or not all closed."""
    if not 1 < mesh.body_count <= MOST_BODIES:
        return [mesh]
    bodies = list(mesh.split(only_watertight=False))
    return bodies if all(body.is_watertight and body.volume > 0 for body in bodies) else [mesh]


def decomposed(mesh: trimesh.Trimesh, settings: Decomposition) -> list[Float[np.ndarray, "_ 3"]]:
    """Vertices [m, mesh frame] of CoACD's pieces.

    Raises:
        MeshError: when there are none.
    """
    import coacd

    coacd.set_log_level("off")
    found = coacd.run_coacd(
        coacd.Mesh(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int32)),
        threshold=settings.concavity,
        max_convex_hull=settings.pieces,
        preprocess_mode="off" if mesh.is_watertight else "on",
        preprocess_resolution=VOXELS_OF_OPEN_MESH,
        resolution=SURFACE_SAMPLES,
        mcts_iterations=settings.iterations,
        mcts_nodes=settings.nodes,
        mcts_max_depth=settings.depth,
        seed=0,
    )
    thinnest = THINNEST_PIECE * float(mesh.extents.max()) ** 3
    pieces = [np.asarray(vertices) for vertices, _ in found if _volume(vertices) > thinnest]
    if not pieces:
        raise MeshError(
            f"the object with {len(mesh.faces)} triangles could not be cut into convex pieces: CoACD returned "
            f"{len(found)}, none of them with a volume; expected a body with a thickness; close its holes or remesh it"
        )
    return pieces


def _volume(vertices: Float[np.ndarray, "_ 3"]) -> float:
    try:
        return float(ConvexHull(vertices).volume)
    except QhullError:
        return 0.0


LinkPieces: TypeAlias = list[list[Float[np.ndarray, "_ 3"]]]
"""Vertices of each link's convex pieces [m, link frame], links in the hand's order."""

LINK_HULLS_TOLERANCE = 2.0e-4  # [m] that a piece may leave out of its hull; a fifth of the penetration that is allowed
HOLLOW = 0.7  # volume / volume of the hull below which a link is cut: the palm's hull fills the hollow of the hand


@cached_per_instance
def link_pieces(hand: Hand) -> LinkPieces:
    """Convex pieces of every link, remembered per hand: a hollow palm takes some seconds."""
    pieces: LinkPieces = []
    for mesh in hand.link_meshes:
        mine: list[Float[np.ndarray, "_ 3"]] = []
        if len(mesh.faces):
            hull = mesh.convex_hull
            hollow = [body for body in bodies_of(mesh) if body.is_watertight]
            if mesh.volume < HOLLOW * hull.volume and hollow:
                for body in hollow:
                    full = body.volume > HOLLOW * body.convex_hull.volume
                    mine.extend([np.asarray(body.vertices)] if full else decomposed(body, DECOMPOSE_LINK))
            else:
                mine.append(np.asarray(hull.vertices))
        pieces.append([simple_hull(vertices, tolerance=LINK_HULLS_TOLERANCE) for vertices in mine])
    return pieces
