"""Where an object is on its way, and how far a lying one must be pushed until a hand can grasp it.

A thin object is graspable where fingers get above and below it. From the geometry of object and surroundings alone: the
shortest translation along the scene's motion after which 30 to 45 % of the object's length in that direction has room above
and below, while its centre of mass stays over the support.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.mechanics.sliding_task import SlidingTask
from dexnudge.planning.lying_object import LyingObject, lying_object
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.motion import Motion, Turn, Twist
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import UPWARD, SupportContacts, support_contacts, turns_in_place

STRIDE = 0.01  # [m] at most between two places
LEAN = np.radians(5.0)  # of the world in which a pinch should still hold what is pulled
STAGE_END = 0.001  # [m] before the end of a turn, from where on forces change to those of the slide


@dataclass(frozen=True, eq=False)
class Station:
    """The object at a place of its way, with the hand that it keeps its contacts with.

    A slide changes nothing of the object's wrenches, so there everything is shifted back to the start.

    Attributes:
        done: share of a push's length that is behind; 0 of a place that belongs to no push.
        T: (4, 4) rigid transform (world) that carries object and hand from the start to here.
        supports: of the object here.
        twist: of the object here.
    """

    done: float
    T: Float[np.ndarray, "4 4"]
    supports: SupportContacts
    twist: Twist

    def moved(self, T: Float[np.ndarray, "4 4"]) -> "Station":
        """Return the place in a world that the rigid transform T has moved, gravity excepted."""
        supports = SupportContacts(
            points=self.supports.points @ T[:3, :3].T + T[:3, 3], normals=self.supports.normals @ T[:3, :3].T
        )
        return Station(self.done, T @ self.T, supports, self.twist.moved(T))

    def task(self, start: SlidingTask) -> SlidingTask:
        """Return the task here of an object that has this task where its motion begins."""
        return replace(start, centre=self.T[:3, :3] @ start.centre + self.T[:3, 3], twist=self.twist)


def stations(scene: Scene, length: float) -> list[Station]:
    """Return places evenly spread over a way of `length` [m], both ends of each stage included, at most 1 cm apart."""
    motion, found, begun = scene.object_motion, list[Station](), 0.0
    for stage in motion.parts(length):
        end = begun + stage if begun + stage == length else begun + stage - min(STAGE_END, stage / 2)
        count = 1 + int(np.ceil(stage / STRIDE))
        shares = np.linspace(begun / length, end / length, count)
        for way, done in zip(np.linspace(begun, end, count), shares, strict=True):
            found.append(replace(station(scene, float(way)), done=float(done)))
        begun += stage
    return found


@cached_per_instance
def station(scene: Scene, way: float) -> Station:
    """Return the object once it has been carried `way` [m] along its motion; remembered per place.

    Where it would tip off what it lies on, its supports are those of the object as it comes to rest (see
    `LyingObject.at_rest`), unless the motion itself tips it.
    """
    motion = scene.object_motion
    return _slid(scene, way) if motion.turn is None else _turned(scene, motion, way)


def _slid(scene: Scene, way: float) -> Station:
    supports, twist = support_contacts(scene), scene.object_motion.twist(way)
    if way > 0:
        T_world_object = np.array(scene.T_world_object)
        T_world_object[:3, 3] += way * scene.motion
        T_world_object = lying_object(scene).rocked(way * scene.motion) @ T_world_object
        found = support_contacts(replace(scene, T_world_object=T_world_object))
        supports = replace(found, points=found.points - way * scene.motion)
    return Station(0.0, np.eye(4), supports, twist)


def _turned(scene: Scene, motion: Motion, way: float) -> Station:
    there = scene.carried(way)
    resting = there
    if way > 0 and stays_flat(scene):
        T_rocked = lying_object(there).rocked(np.zeros(3))
        resting = replace(there, T_world_object=T_rocked @ there.T_world_object)
    supports = support_contacts(resting)
    if pulled(scene):  # out of a row: what stands beside it is soon gone, and wedges what leans on it
        below = supports.normals[:, 2] > UPWARD
        supports = SupportContacts(points=supports.points[below], normals=supports.normals[below])
    return Station(0.0, motion.displacement(way), supports, motion.twist(way))


def stays_flat(scene: Scene) -> bool:
    """Return whether the object keeps lying on its support as it moves: it slides, or turns about the support's normal."""
    return scene.turn is None or turns_in_place(scene)


def pulled(scene: Scene) -> bool:
    """Return whether the object is tipped and then slides: a hand pinches it, and nothing else keeps it upright."""
    return scene.turn is not None and scene.motion_length > 0 and not stays_flat(scene)


def leans(scene: Scene) -> list[Float[np.ndarray, "4 4"]]:
    """Return rigid transforms (world) that lean the world to the left and right of the way of what is `pulled`; else none.

    Contacts wander: a hand that holds the object there, too, has something left for that.
    """
    if not pulled(scene):
        return []
    return [Turn(LEAN, sign * scene.motion, scene.centre_of_mass).transform(LEAN) for sign in (-1.0, 1.0)]


def check_slides(scene: Scene, what: str) -> None:
    """Refuse a scene that turns its object; `what` can only slide one.

    Raises:
        InputError: saying by how much it turns, and what to do instead.
    """
    if scene.turn is not None:
        raise InputError(
            f"the motion of '{scene.name}' turns the object by {np.degrees(scene.turn.angle):.0f} deg; expected a slide "
            f"alone: {what} turns or tips no object; play it with the hand alone (execute), or leave out the `turn`"
        )


STEP = 0.0025  # [m] between the places that are tried
BALANCE_STEPS = 4  # of these per check of the balance: where support ends is found 10 mm too late at most
FRONTS = 16  # of these whose fronts are looked at in one query
PARTS = (0.3, np.inf)  # of its length, in which points without room are looked for at its front
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
    free = _free_part(lying, _Along.of(lying, direction), way * direction, limits.room)
    return ObjectMotion(start, start + way * direction, *free)


def _distance(lying: LyingObject, direction: np.ndarray, limits: GraspableLimits) -> float | Outcome:
    """Return the least way [m] along a direction to where the object is graspable."""
    free_way = lying.free_travel(direction, reach=LONGEST + STOP_SHORT) - STOP_SHORT
    places, along = np.arange(0.0, free_way, STEP)[:, None] * direction, _Along.of(lying, direction)
    for index, place in enumerate(places):
        if index % FRONTS == 0:
            carried = lying.front_is_carried(places[index : index + FRONTS], direction, limits.room)
        if index % BALANCE_STEPS == 0 and not lying.keeps_balance(place, least=limits.balance):
            return Outcome.WOULD_TIP
        if carried[index % FRONTS]:
            continue
        overhang, free_length = _free_part(lying, along, place, limits.room)
        if overhang > limits.overhang[1]:
            return Outcome.WOULD_OVERHANG
        if overhang >= limits.overhang[0] and free_length >= LEAST_FREE:
            if not lying.keeps_balance(place, least=limits.balance):
                return Outcome.WOULD_TIP
            return index * STEP
    return Outcome.OBSTRUCTED if free_way < LONGEST - STEP else Outcome.NO_EDGE


@dataclass(frozen=True)
class _Along:
    """Where an object's front is along a direction, its length, and its points of both sides [m]."""

    front: float
    length: float
    lower: Float[np.ndarray, " n"]
    upper: Float[np.ndarray, " m"]

    @classmethod
    def of(cls, lying: LyingObject, direction: np.ndarray) -> "_Along":
        along = lying.points @ direction
        return cls(float(along.max()), float(np.ptp(along)), lying.lower @ direction, lying.upper @ direction)


def _free_part(lying: LyingObject, along: _Along, shift: np.ndarray, room: float) -> tuple[float, float]:
    """Return overhang [-] and length [m] of the free part of the shifted object; see `ObjectMotion`."""
    for share in PARTS:  # from the front, until something has no room
        lower, upper = (side > along.front - share * along.length for side in (along.lower, along.upper))
        below, above = lying.below(shift, lower), lying.above(shift, upper)
        tight = np.concatenate([along.lower[lower][below < room], along.upper[upper][above < room]])
        if len(tight):
            break
    edge = float(tight.max(initial=-np.inf))
    roomy = np.concatenate([side[side > edge] for side in (along.lower, along.upper)])
    free = along.front - float(roomy.min(initial=along.front))  # from a point that has room: never more than is free
    return free / along.length, free


@cached_per_instance
def push_length(scene: Scene) -> float:
    """Return the length of the scene's motion [m], or the shorter way after which the object is graspable over an edge.

    Beyond that, 30 % of its length hang over and a grasp takes over; some centimetres farther the support would no longer
    carry the object, and nothing that slides on it could be in balance. A turn is made to its end, and so is a slide of an
    object that has been tipped.
    """
    motion = scene.object_motion
    if motion.turn is not None:
        slides_flat = motion.slide_length > 0 and stays_flat(scene)
        return motion.turn_length + push_length(scene.carried(motion.turn_length)) if slides_flat else motion.length
    plan = plan_object_motion(scene)
    if isinstance(plan, Outcome) or plan.length == 0.0:
        return scene.motion_length
    return min(scene.motion_length, plan.length)
