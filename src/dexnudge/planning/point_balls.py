"""A hand's surface points in nested balls, laid out so that a kernel can walk them without a stack."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from dexnudge.hands.hand import LinkPoints

BRANCHES = 4  # children of a ball: fewer levels than a binary tree, tighter balls than a wide one


@dataclass(frozen=True)
class PointBalls:
    """Balls in depth-first order, each about one of its own points, so that the distance at its centre is a result.

    A ball of radius 0 is a single point. `point` [m] in the frame of `link`; `following`: index of the next ball for a
    walk that leaves out what is inside this one (Smits, "Efficiency issues for ray tracing", 1998).
    """

    point: Float[np.ndarray, "ball 3"]
    radius: Float[np.ndarray, " ball"]
    link: Int[np.ndarray, " ball"]
    following: Int[np.ndarray, " ball"]


def point_balls(points: LinkPoints) -> PointBalls:
    """Nested balls over the points; the outermost ones hold a whole link each."""
    balls: list[tuple[int, float]] = []
    following: list[int] = []

    def add(members: Int[np.ndarray, " n"]) -> None:
        own = points.points[members]
        middle = 0.5 * (own.min(axis=0) + own.max(axis=0))
        centre = int(np.argmin(np.linalg.norm(own - middle, axis=1)))
        index = len(balls)
        balls.append((int(members[centre]), float(np.linalg.norm(own - own[centre], axis=1).max())))
        following.append(0)
        if len(members) > 1:
            for part in _split(points.points, members):
                add(part)
        following[index] = len(balls)

    for link in np.unique(points.link):
        add(np.flatnonzero(points.link == link))
    centres = np.array([centre for centre, _ in balls])
    return PointBalls(
        points.points[centres],
        np.array([radius for _, radius in balls]),
        points.link[centres].astype(np.int32),
        np.array(following, dtype=np.int32),
    )


def _split(points: Float[np.ndarray, "p 3"], members: Int[np.ndarray, " n"]) -> list[Int[np.ndarray, " _"]]:
    """Up to `BRANCHES` parts, by halving the largest at the median of its widest direction."""
    parts = [members]
    while len(parts) < min(BRANCHES, len(members)):
        largest = parts.pop(int(np.argmax([len(part) for part in parts])))
        widest = int(np.argmax(np.ptp(points[largest], axis=0)))
        order = largest[np.argsort(points[largest, widest], kind="stable")]
        parts += [order[: len(order) // 2], order[len(order) // 2 :]]
    return parts
