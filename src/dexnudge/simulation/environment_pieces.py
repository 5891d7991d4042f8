"""The surroundings as convex bodies, which is what MuJoCo's contacts are made of.

A connected part that is convex, as every board and wall of the scene families is, is taken as it stands; the others are
cut by CoACD, and what comes out is measured against the part: what it adds to the part is where nothing is in truth.
"""

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from dexnudge.errors import MeshError
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_points import surface_points
from dexnudge.simulation.convex_pieces import CONVEX_ENOUGH, Decomposition, decomposed, simple_hull

MOST_ADDED = 0.002  # [m] that pieces may reach out of their part: what a hand may be in the surroundings
CHECK_SPACING = 0.005  # [m] between the points of the pieces that are looked for outside their part
THINNEST = 1.0e-4  # [m] mean thickness of a part; a thinner one is a sheet
TOLERANCE = 1.0e-4  # [m] that a piece may leave out of its hull
DECOMPOSE_ENVIRONMENT = Decomposition(concavity=0.01, pieces=-1, iterations=60, nodes=10, depth=3)  # the finest cuts


def environment_pieces(mesh: trimesh.Trimesh) -> list[Float[np.ndarray, "_ 3"]]:
    """Vertices [m, world] of convex bodies that together are the surroundings.

    Raises:
        MeshError: naming the part that is a sheet, or that convex bodies do not describe to 2 mm.
    """
    parts = list(mesh.split(only_watertight=False))
    pieces: list[Float[np.ndarray, "_ 3"]] = []
    for index, part in enumerate(parts):
        pieces.extend(_pieces_of(part, f"part {index + 1} of {len(parts)} of the environment"))
    return pieces


def _pieces_of(part: trimesh.Trimesh, name: str) -> list[Float[np.ndarray, "_ 3"]]:
    x, y, z = part.bounds.mean(axis=0)
    name = f"{name} ({len(part.faces)} triangles around ({x:.3f}, {y:.3f}, {z:.3f}))"
    hull_volume = _hull_volume(part)
    if hull_volume < THINNEST * float(np.sort(part.extents)[1:].prod()):
        raise MeshError(
            f"{name} is a flat sheet; MuJoCo's contacts expect bodies with a thickness; make a box of it, or leave it out"
        )
    if part.is_watertight and part.volume > CONVEX_ENOUGH * hull_volume:
        return [simple_hull(np.asarray(part.vertices), tolerance=TOLERANCE)]
    try:
        found = [simple_hull(piece, tolerance=TOLERANCE) for piece in decomposed(part, DECOMPOSE_ENVIRONMENT)]
    except (MeshError, QhullError) as error:
        raise MeshError(
            f"{name} cannot be cut into the convex bodies that MuJoCo needs ({str(error).splitlines()[0]}); expected a "
            "closed body; close its holes or build it of boxes"
        ) from error
    added = _added(part, found)
    if added > MOST_ADDED:
        raise MeshError(
            f"{name} is not convex, and the {len(found)} convex bodies that MuJoCo would take for it reach "
            f"{1e3 * added:.1f} mm out of it; expected at most {1e3 * MOST_ADDED:.0f} mm; build it of convex bodies that "
            "are not connected, such as boxes" + ("" if part.is_watertight else ", or close its holes")
        )
    return found


def _hull_volume(part: trimesh.Trimesh) -> float:
    try:
        return float(ConvexHull(part.vertices).volume)
    except QhullError:
        return 0.0


def _added(part: trimesh.Trimesh, pieces: list[Float[np.ndarray, "_ 3"]]) -> float:
    """How far the pieces reach out of the part [m], on points of their surfaces."""
    distance = ExactDistance(part)
    hulls = [trimesh.convex.convex_hull(piece) for piece in pieces]
    points = np.concatenate([surface_points(hull, spacing=CHECK_SPACING).points for hull in hulls])
    return float(distance(points).distance.max())
