"""Where a lying object must be moved so that a hand can grasp it: over an edge, until enough of it is free.

A thin object is graspable where fingers get above and below it. From the geometry of object and surroundings alone: the
shortest translation along the support, in one piece or two, after which 30 to 45 % of the object's length (in the direction
of the motion) has room above and below, while its centre of mass stays over the support.
"""

from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.mechanics.contacts import SupportContacts, support_contacts
from dexnudge.planning.lying_object import SEEN, LyingObject, lying_object
from dexnudge.scenes.scene import Scene

STRIDE = 0.01  # [m] at most between two places


def supports_of_way(scene: Scene, length: float) -> list[SupportContacts]:
    """Supports at places evenly spread over a way of `length` [m], both ends included, at most a centimetre apart."""
    return [supports_along(scene, way) for way in np.linspace(0.0, length, 1 + int(np.ceil(length / STRIDE)))]


def supports_along(scene: Scene, way: float) -> SupportContacts:
    """Supports of the object once it has been carried `way` [m] along the motion; found once a place.

    Where it would tip there, it is looked at as it comes to rest (see `LyingObject.at_rest`). They are given as the object
    sees them: less the way, so that they go with the contacts and the centre of mass of the scene as it is.
    """
    if way == 0:
        return support_contacts(scene)
    known = _known(scene)
    if way not in known:
        T_world_object = np.array(scene.T_world_object)
        T_world_object[:3, 3] += way * scene.motion
        T_world_object = lying_object(scene).at_rest(way * scene.motion, least=0.0).T_rocked @ T_world_object
        found = support_contacts(replace(scene, T_world_object=T_world_object))
        known[way] = replace(found, points=found.points - way * scene.motion)
    return known[way]


@cached_per_instance
def _known(_: Scene) -> dict[float, SupportContacts]:
    """By the way [m]; empty at first."""
    return {}


STEP = 0.0025  # [m] between the places looked at along a direction
FIRST_LEGS = (0.05, 0.12)  # [m] of a first piece, tried where no single piece will do
EVERY_SECOND = 2  # of the directions is tried in ways of two pieces
BALANCE_STEPS = 4  # places along a direction per look at the balance: where support ends is 10 mm too late at most
STOP_SHORT = 0.001  # [m] kept from what ends a free way


@dataclass(frozen=True, kw_only=True)
class GraspableLimits:
    """What makes an object graspable.

    overhang: least and most free part of its length along the last piece of the motion [-]. room: least way above and below
    the free part [m]: a finger is 20 mm thick. free_length: least length of the free part [m]: a fingertip's. balance: least
    distance from the centre of mass to the edge of the support [m], all the way. longest: of the whole motion [m].
    directions: evenly spread ones that are tried, besides the scene's own motion.

    Raises:
        InputError: a value out of its domain.
    """

    overhang: tuple[float, float] = (0.30, 0.45)
    room: float = 0.025
    free_length: float = 0.020
    balance: float = 0.004
    longest: float = 1.0
    directions: int = 16

    def __post_init__(self) -> None:
        least, most = self.overhang
        if not 0 < least <= most < 1:
            raise InputError(f"overhang is {self.overhang}; expected two fractions, 0 < least <= most < 1")
        for name in ("room", "free_length", "balance", "longest", "directions"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} is {getattr(self, name)}; expected a number above 0")


DEFAULT_LIMITS = GraspableLimits()


@dataclass(frozen=True)
class ObjectMotion:
    """A way of the object to where it is graspable.

    Attributes:
        poses: (k, 4, 4) T_world_object at the corners of the way, the first at rest, translations between
            them; that one alone where the object is graspable as it lies.
        overhang: free part of the object's length along the last piece [-].
        free_length: the same in metres.
        room_below, room_above: least way from the free part to the surroundings along the support's normal [m], up to 1 m.
        balance: distance from the centre of mass to the edge of what carries the object at the end [m].
        support_normal: (3,) unit, world.
    """

    poses: Float[np.ndarray, "k 4 4"]
    overhang: float
    free_length: float
    room_below: float
    room_above: float
    balance: float
    support_normal: Float[np.ndarray, "3"]

    @property
    def length(self) -> float:
        """Length of the way [m]."""
        return float(np.linalg.norm(np.diff(self.poses[:, :3, 3], axis=0), axis=1).sum())

    def pose_at(self, distance: float) -> Float[np.ndarray, "4 4"]:
        """T_world_object after `distance` [m] of the way; its ends beyond them."""
        corners = self.poses[:, :3, 3]
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
        pose = self.poses[0].copy()
        pose[:3, 3] = [np.interp(distance, along, corners[:, axis]) for axis in range(3)]
        return pose


@dataclass(frozen=True)
class NoObjectMotion:
    """No way was found; `reason` says what stood against it in how many directions."""

    reason: str


@dataclass
class _Refusals:
    """In how many tried directions what happened first."""

    counts: dict[str, int] = field(default_factory=dict)

    def add(self, reason: str) -> None:
        self.counts[reason] = self.counts.get(reason, 0) + 1

    def text(self) -> str:
        ordered = sorted(self.counts.items(), key=lambda item: (-item[1], item[0]))
        return ", ".join(f"{reason} ({count})" for reason, count in ordered)


@dataclass(frozen=True)
class _Free:
    """The free part of the object at one place; see `ObjectMotion`."""

    overhang: float
    length: float
    below: float
    above: float


@dataclass(frozen=True)
class _Way:
    """Translations one after another [m], their length, and the direction of the last one."""

    length: float
    pieces: list[np.ndarray]
    direction: Float[np.ndarray, "3"]


def plan_object_motion(
    scene: Scene, limits: GraspableLimits = DEFAULT_LIMITS, *, own_motion_only: bool = False
) -> ObjectMotion | NoObjectMotion:
    """The shortest way after which the object is graspable; see the head of this file for what that means.

    One straight piece where that will do, else two. The object is lifted 1.5 mm in the mind, so the support itself is no
    obstacle and a low step is none either; rays along the way find every other. With `own_motion_only` the way is straight
    along the scene's motion, for hands that were sampled for it.
    """
    lying = lying_object(scene)
    if not lying.normal.any():
        return NoObjectMotion("nothing below carries the object at rest")
    directions = _directions(lying, scene.motion, limits.directions)
    if own_motion_only:
        directions = directions[:1]
    refused = _Refusals()
    best: _Way | None = None
    for direction in directions:
        reach = limits.longest if best is None else best.length
        way = _distance(lying, np.zeros(3), direction, reach, limits, refused)
        if way is not None and (best is None or way < best.length):
            best = _Way(way, [way * direction] if way else [], direction)
    if best is None and not own_motion_only:
        best = _two_pieces(lying, directions, limits)
    if best is None:
        tried = (
            "along the scene's motion" if own_motion_only else f"in any of {len(directions)} directions or two pieces"
        )
        return NoObjectMotion(
            f"nowhere {tried} does {limits.overhang[0]:.0%} of the "
            f"object's length come free with {1e3 * limits.room:.0f} mm of room above and below: {refused.text()}"
        )
    return _result(scene, lying, best, limits)


def _result(scene: Scene, lying: LyingObject, way: _Way, limits: GraspableLimits) -> ObjectMotion:
    shifts = np.concatenate([np.zeros((1, 3)), np.cumsum(np.reshape(way.pieces, (-1, 3)), axis=0)])
    poses = np.repeat(scene.T_world_object[None], len(shifts), axis=0)
    poses[:, :3, 3] += shifts
    end = shifts[-1]
    free = _free_part(lying, end, way.direction, limits)
    balance = lying.at_rest(end, least=limits.balance).margin
    return ObjectMotion(poses, free.overhang, free.length, free.below, free.above, balance, lying.normal)


def _directions(lying: LyingObject, motion: np.ndarray, count: int) -> Float[np.ndarray, "n 3"]:
    """Unit directions in the support's plane, the scene's own first."""
    angles = 2 * np.pi * np.arange(count) / count
    spread = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ lying.plane_axes()
    own = motion - (motion @ lying.normal) * lying.normal
    length = np.linalg.norm(own)
    return np.concatenate([own[None] / length, spread]) if length > 1e-6 else spread


def _distance(
    lying: LyingObject,
    shift: np.ndarray,
    direction: np.ndarray,
    reach: float,
    limits: GraspableLimits,
    refused: _Refusals,
) -> float | None:
    """Least way [m] along a direction from a place to where the object is graspable; None where that is nowhere."""
    free_way = lying.free_travel(shift, direction, reach=reach + STOP_SHORT) - STOP_SHORT
    for index, way in enumerate(np.arange(0.0, free_way, STEP)):
        place = shift + way * direction
        if index % BALANCE_STEPS == 0 and lying.at_rest(place, least=limits.balance).margin < limits.balance:
            refused.add("it would tip first")
            return None
        if lying.front_is_carried(place, direction, limits.room):
            continue
        free = _free_part(lying, place, direction, limits)
        if free.overhang > limits.overhang[1]:
            refused.add("it would hang over too far")
            return None
        if free.overhang >= limits.overhang[0] and free.length >= limits.free_length:
            if lying.at_rest(place, least=limits.balance).margin < limits.balance:
                refused.add("it would tip first")
                return None
            return float(way)
    refused.add("something is in the way" if free_way < reach - STEP else "no edge within reach")
    return None


def _free_part(lying: LyingObject, shift: np.ndarray, direction: np.ndarray, limits: GraspableLimits) -> _Free:
    """The foremost part of the object in which every point of both sides has room."""
    below, above = lying.below(shift), lying.above(shift)
    lower, upper = lying.lower @ direction, lying.upper @ direction
    along = lying.points @ direction
    front, length = float(along.max()), float(np.ptp(along))
    tight = np.concatenate([lower[below < limits.room], upper[above < limits.room]])
    edge = float(tight.max(initial=-np.inf))
    roomy = np.concatenate([lower[lower > edge], upper[upper > edge]])
    free = front - float(roomy.min(initial=front))  # from a point that has room: never more than is free
    return _Free(
        free / length,
        free,
        float(below[lower > edge].min(initial=SEEN)),
        float(above[upper > edge].min(initial=SEEN)),
    )


def _two_pieces(lying: LyingObject, directions: np.ndarray, limits: GraspableLimits) -> _Way | None:
    """The shortest of the ways with a first piece of one of `FIRST_LEGS`; None where none leads there."""
    best: _Way | None = None
    ignored = _Refusals()
    directions = np.concatenate([directions[:1], directions[1::EVERY_SECOND]])
    for first, leg in product(directions, FIRST_LEGS):
        reach = (limits.longest if best is None else best.length) - leg
        if reach <= 0 or lying.free_travel(np.zeros(3), first, reach=leg + 2 * STOP_SHORT) < leg + STOP_SHORT:
            continue
        places = [way * first for way in np.arange(STEP, leg, 2 * STEP)] + [leg * first]
        if min(lying.at_rest(place, least=limits.balance).margin for place in places) < limits.balance:
            continue
        for second in directions:
            way = _distance(lying, leg * first, second, reach, limits, ignored)
            if way and (best is None or leg + way < best.length):
                best = _Way(leg + way, [leg * first, way * second], second)
                reach = way
    return best


@cached_per_instance
def push_length(scene: Scene) -> float:
    """`scene.motion_length` [m], or the shorter way after which the object is graspable over an edge.

    Beyond that, 30 % of its length hang over and a grasp takes over; some centimetres farther the support would no longer
    carry the object, and nothing that slides on it could be in balance.
    """
    plan = plan_object_motion(scene, own_motion_only=True)
    if isinstance(plan, NoObjectMotion) or plan.length == 0.0:
        return scene.motion_length
    return min(scene.motion_length, plan.length)
