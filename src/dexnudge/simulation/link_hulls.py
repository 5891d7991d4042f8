"""The hand's links as convex bodies with few vertices: MuJoCo's contacts are between convex bodies, and small ones are fast.

A link counts as its convex hull, as in most simulations of hands; only a link whose hull reaches far outside it, as the
hull over the hollow of a palm does, is cut into several.
"""

from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from dexnudge.hands.hand import Hand
from dexnudge.made_once import made_once
from dexnudge.simulation.convex_pieces import DECOMPOSE_LINK, bodies_of, decomposed
from dexnudge.simulation.simple_hull import simple_hull

LinkPieces: TypeAlias = list[list[Float[np.ndarray, "_ 3"]]]
"""Vertices of each link's convex pieces [m, link frame], links in the hand's order."""

TOLERANCE = 2.0e-4  # [m] that a piece may leave out of its hull; a fifth of the penetration that is allowed
HOLLOW = 0.7  # volume / volume of the hull below which a link is cut: the palm's hull fills the hollow of the hand


@made_once
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
        pieces.append([simple_hull(vertices, tolerance=TOLERANCE) for vertices in mine])
    return pieces
