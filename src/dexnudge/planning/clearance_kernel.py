"""Warp kernel: least signed distance of a hand's surface points to the environment and to the object.

The exact distance is used, not a grid: a hand travels farther than a fine grid could reach. Distance changes no faster
than one moves, so a ball whose centre is farther than its radius plus the least distance found so far is passed over
with all that is in it. What is far need not be known exactly: the result is a lower bound, at most 24 % below the least
distance of the points, and the less the nearer: exact where it is zero or negative.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from dexnudge.geometry.disk_cache import cached_array
from dexnudge.geometry.exact_distance import INSIDE_WINDING_NUMBER, WINDING_ACCURACY
from dexnudge.geometry.warp_runtime import wp
from dexnudge.hands.hand import LinkPoints
from dexnudge.hands.kinematics import KinematicTree, place_links

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
    """Nested balls over the points; the outermost ones hold a whole link each. Kept on disk: a hand's take a second."""
    rows = cached_array("nested balls 1", [points.points, points.link], lambda: _nested_balls(points))
    centres = rows[:, 0].astype(np.int64)
    return PointBalls(
        points.points[centres], rows[:, 1], points.link[centres].astype(np.int32), rows[:, 2].astype(np.int32)
    )


def _nested_balls(points: LinkPoints) -> Float[np.ndarray, "ball 3"]:
    """Return for each ball the point at its centre, its radius [m], and the ball that follows."""
    balls: list[list[float]] = []

    def add(members: Int[np.ndarray, " n"]) -> None:
        own = points.points[members]
        middle = 0.5 * (own.min(axis=0) + own.max(axis=0))
        centre = int(np.argmin(np.linalg.norm(own - middle, axis=1)))
        ball = [float(members[centre]), float(np.linalg.norm(own - own[centre], axis=1).max()), 0.0]
        balls.append(ball)
        if len(members) > 1:
            for part in _split(points.points, members):
                add(part)
        ball[2] = len(balls)

    for link in np.unique(points.link):
        add(np.flatnonzero(points.link == link))
    return np.array(balls).reshape(-1, 3)


def joined_balls(parts: Sequence[PointBalls]) -> PointBalls:
    """Return the balls of several sets of links as one."""
    before = np.cumsum([0, *(len(part.point) for part in parts)])[:-1]
    return PointBalls(
        np.concatenate([part.point for part in parts]),
        np.concatenate([part.radius for part in parts]),
        np.concatenate([part.link for part in parts]),
        np.concatenate([part.following + first for part, first in zip(parts, before, strict=True)]).astype(np.int32),
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


SMALL_BALL = wp.constant(0.3)  # a ball this much smaller than its clearance is not opened: its own bound will do
FAR = wp.constant(1.0e3)  # [m] farther than any scene is wide


@wp.struct
class ClearanceHand:
    """Kinematic tree and nested balls of surface points; see `Hand` and `PointBalls`."""

    tree: KinematicTree
    point: wp.array(dtype=wp.vec3)  # (N,) [m] link frame
    radius: wp.array(dtype=float)  # (N,) [m]
    link: wp.array(dtype=int)  # (N,)
    following: wp.array(dtype=int)  # (N,)
    padding: wp.array(dtype=float)  # (L,) [m] by which each link counts as thicker than it is


@wp.struct
class Obstacle:
    """A mesh in the working frame and its bounding box [m]."""

    mesh: wp.uint64
    low: wp.vec3
    high: wp.vec3


@wp.struct
class HandStates:
    """What one launch reads and writes; B hands."""

    translation: wp.array(dtype=wp.vec3)  # (B,) [m] working frame
    rotation: wp.array(dtype=wp.mat33)  # (B,)
    joint_angles: wp.array2d(dtype=float)  # (B, d)
    link_translation: wp.array2d(dtype=wp.vec3)  # (B, L)
    link_rotation: wp.array2d(dtype=wp.mat33)  # (B, L)
    distance: wp.array2d(dtype=float)  # (B, 2) to the environment, to the object [m]
    nearest: wp.array2d(dtype=int)  # (B, 2) the ball whose centre is nearest; -1 where all are beyond the cap


@wp.func
def signed_distance(obstacle: Obstacle, p: wp.vec3, reach: float, known: wp.vec4) -> float:
    """Distance [m], negative inside; `reach` where p is outside and farther than that.

    `known`: a place and how far it is from the obstacle, at least. Within that, p is outside too, and needs no sign.
    """
    low = obstacle.low
    high = obstacle.high
    outside = p[0] < low[0] or p[1] < low[1] or p[2] < low[2] or p[0] > high[0] or p[1] > high[1] or p[2] > high[2]
    if outside or wp.length(p - wp.vec3(known[0], known[1], known[2])) < known[3]:
        near = wp.mesh_query_point_no_sign(obstacle.mesh, p, reach)
        if not near.result:
            return reach
        return wp.length(p - wp.mesh_eval_position(obstacle.mesh, near.face, near.u, near.v))
    # Otherwise the sign matters even far from the surface: p may be deep inside.
    hit = wp.mesh_query_point_sign_winding_number(obstacle.mesh, p, FAR, WINDING_ACCURACY, INSIDE_WINDING_NUMBER)
    return hit.sign * wp.length(p - wp.mesh_eval_position(obstacle.mesh, hit.face, hit.u, hit.v))


@wp.func
def least_distance(
    hand: ClearanceHand, states: HandStates, obstacle: Obstacle, cap: float, stop: float, i: int, column: int
):
    """Walks the balls; a result below `stop` ends the walk and is then not the least, but below `stop`."""
    best = float(cap)
    nearest = int(-1)  # noqa: RUF046 - declares a variable of Warp
    known = wp.vec4()
    ball = int(0)  # noqa: RUF046 - as above
    while ball < hand.point.shape[0]:
        l = hand.link[ball]
        p = states.link_translation[i, l] + states.link_rotation[i, l] * hand.point[ball]
        radius = hand.radius[ball]
        distance = signed_distance(obstacle, p, best + radius + hand.padding[l], known)
        if distance > 0.0:
            known = wp.vec4(p[0], p[1], p[2], distance)
        distance = distance - hand.padding[l]
        if distance < stop:
            best = distance
            nearest = ball
            break
        bound = distance - radius
        if bound >= best:
            ball = hand.following[ball]
        elif radius <= SMALL_BALL * bound or radius == 0.0:
            best = bound
            nearest = ball
            ball = hand.following[ball]
        else:
            ball = ball + 1
    states.distance[i, column] = best
    states.nearest[i, column] = nearest


@wp.kernel(enable_backward=False)
def clearances(
    hand: ClearanceHand, environment: Obstacle, thing: Obstacle, states: HandStates, cap: float, stop: float
):
    """Poses of the links, then the least distance to either mesh; one thread per hand."""
    i = wp.tid()
    place_links(
        hand.tree,
        states.rotation[i],
        states.translation[i],
        states.joint_angles,
        i,
        states.link_rotation,
        states.link_translation,
    )
    least_distance(hand, states, environment, cap, stop, i, 0)
    if states.distance[i, 0] >= stop:
        least_distance(hand, states, thing, cap, stop, i, 1)
    else:
        states.distance[i, 1] = cap
        states.nearest[i, 1] = -1
