"""How far a lying object must be pushed until a hand can grasp it: over an edge, until enough of it is free.

A thin object is graspable where fingers get above and below it. From the geometry of object and surroundings alone: the
shortest translation along the scene's motion after which 30 to 45 % of the object's length in that direction has room above
and below, while its centre of mass stays over the support.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from dexnudge.jobs.cached import cached_per_instance
from dexnudge.planning.lying_object import LyingObject, lying_object
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import SupportContacts, support_contacts

STRIDE = 0.01  # [m] at most between two places


def supports_of_way(scene: Scene, length: float) -> list[SupportContacts]:
    """Return the supports at places evenly spread over a way of `length` [m], both ends included, at most 1 cm apart."""
    return [supports_along(scene, way) for way in np.linspace(0.0, length, 1 + int(np.ceil(length / STRIDE)))]


def supports_along(scene: Scene, way: float) -> SupportContacts:
    """Return the supports of the object once it has been carried `way` [m] along the motion; remembered per place.

    Where it would tip there, they are those of the object as it comes to rest (see `LyingObject.at_rest`). The way is
    subtracted, so that they go with the contacts and the centre of mass of the scene as it is.
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


STEP = 0.0025  # [m] between the places that are tried
BALANCE_STEPS = 4  # of these per check of the balance: where support ends is found 10 mm too late at most
STOP_SHORT = 0.001  # [m] kept from what ends a free way
LEAST_FREE = 0.020  # [m] least length of the free part: a fingertip's
LONGEST = 1.0  # [m] of the whole motion


@dataclass(frozen=True, kw_only=True)
class GraspableLimits:
    """What makes an object graspable.

    overhang: least and most free part of its length along the motion [-], 0 < least <= most < 1. room: least way above and
    below the free part [m]: a finger is 20 mm thick. balance: least distance from the centre of mass to the edge of the
    support [m], all the way.
    """

    overhang: tuple[float, float] = (0.30, 0.45)
    room: float = 0.025
    balance: float = 0.004


DEFAULT_LIMITS = GraspableLimits()


@dataclass(frozen=True)
class ObjectMotion:
    """A path of the object to where it can be grasped.

    start, end: of the origin of its frame [m, world]; the same where the object is graspable as it lies. overhang: the
    foremost part of its length along the motion in which every point of both sides has room at the end [-]. free_length: the
    same in metres.
    """

    start: Float[np.ndarray, "3"]
    end: Float[np.ndarray, "3"]
    overhang: float
    free_length: float

    @property
    def length(self) -> float:
        """Length of the way [m]."""
        return float(np.sqrt(((self.end - self.start) ** 2).sum()))


def plan_object_motion(scene: Scene, limits: GraspableLimits = DEFAULT_LIMITS) -> ObjectMotion | Outcome:
    """Return the shortest way along the scene's motion after which the object is graspable, or why there is none.

    The object is tried 1.5 mm above its support, so the support itself is no obstacle and a low step is none either; rays
    along the way find every other.
    """
    lying = lying_object(scene)
    if not lying.normal.any():
        return Outcome.UNSUPPORTED
    direction = scene.motion - (scene.motion @ lying.normal) * lying.normal
    length = np.linalg.norm(direction)
    if length < 1e-6:  # straight off the support
        return Outcome.NO_EDGE
    direction = direction / length
    way = _distance(lying, direction, limits)
    if isinstance(way, Outcome):
        return way
    start = scene.T_world_object[:3, 3]
    return ObjectMotion(start, start + way * direction, *_free_part(lying, way * direction, direction, limits.room))


def _distance(lying: LyingObject, direction: np.ndarray, limits: GraspableLimits) -> float | Outcome:
    """Return the least way [m] along a direction to where the object is graspable."""
    free_way = lying.free_travel(direction, reach=LONGEST + STOP_SHORT) - STOP_SHORT
    for index, way in enumerate(np.arange(0.0, free_way, STEP)):
        place = way * direction
        if index % BALANCE_STEPS == 0 and lying.at_rest(place, least=limits.balance).margin < limits.balance:
            return Outcome.WOULD_TIP
        if lying.front_is_carried(place, direction, limits.room):
            continue
        overhang, free_length = _free_part(lying, place, direction, limits.room)
        if overhang > limits.overhang[1]:
            return Outcome.WOULD_OVERHANG
        if overhang >= limits.overhang[0] and free_length >= LEAST_FREE:
            if lying.at_rest(place, least=limits.balance).margin < limits.balance:
                return Outcome.WOULD_TIP
            return float(way)
    return Outcome.OBSTRUCTED if free_way < LONGEST - STEP else Outcome.NO_EDGE


def _free_part(lying: LyingObject, shift: np.ndarray, direction: np.ndarray, room: float) -> tuple[float, float]:
    """Return overhang [-] and length [m] of the free part of the shifted object; see `ObjectMotion`."""
    below, above = lying.below(shift), lying.above(shift)
    lower, upper = lying.lower @ direction, lying.upper @ direction
    along = lying.points @ direction
    front, length = float(along.max()), float(np.ptp(along))
    tight = np.concatenate([lower[below < room], upper[above < room]])
    edge = float(tight.max(initial=-np.inf))
    roomy = np.concatenate([lower[lower > edge], upper[upper > edge]])
    free = front - float(roomy.min(initial=front))  # from a point that has room: never more than is free
    return free / length, free


@cached_per_instance
def push_length(scene: Scene) -> float:
    """Return `scene.motion_length` [m], or the shorter way after which the object is graspable over an edge.

    Beyond that, 30 % of its length hang over and a grasp takes over; some centimetres farther the support would no longer
    carry the object, and nothing that slides on it could be in balance.
    """
    plan = plan_object_motion(scene)
    if isinstance(plan, Outcome) or plan.length == 0.0:
        return scene.motion_length
    return min(scene.motion_length, plan.length)
