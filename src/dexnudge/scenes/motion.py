"""The motion that an object should make: first an optional turn about an axis, then a slide along a line."""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.errors import SceneError, quote
from dexnudge.geometry.rigid import FARTHEST, real_numbers, unit_vector

LEAST_TURN = 0.1  # [deg] a smaller one is lost in the tolerances of 1 mm
HALF_TURN = 180.0  # [deg] a larger one is a smaller one the other way round
SMALLEST_TURN, LARGEST_TURN = float(np.radians(LEAST_TURN)), np.pi  # [rad]
FARTHEST_AXIS = 2.0  # [m] of a turn's axis from the object: farther off it is a slide, or in another unit


@dataclass(frozen=True, eq=False)
class Twist:
    """Velocity of a rigid body: a point x (world) of it moves at linear + angular x x.

    Scaled so that the body's fastest point moves at 1 m per metre of way. linear: [m/m]. angular: [rad/m].
    """

    linear: Float[np.ndarray, "3"]
    angular: Float[np.ndarray, "3"]

    def velocity(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Return the velocity of points of the body [m, world]."""
        return self.linear + np.cross(self.angular, points)

    def direction(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Return the same as unit vectors; zeros on the axis of a turn."""
        velocity = self.velocity(points)
        if not self.angular.any():
            return velocity
        return velocity / np.maximum(np.linalg.norm(velocity, axis=-1, keepdims=True), np.finfo(float).tiny)

    def moved(self, T: Float[np.ndarray, "4 4"]) -> Twist:
        """Return the twist of a body that, with everything around it, is moved by the rigid transform T."""
        rotation = T[:3, :3]
        angular = rotation @ self.angular
        return Twist(rotation @ self.linear - np.cross(angular, T[:3, 3]), angular)


@dataclass(frozen=True, eq=False)
class Turn:
    """A turn of the object by `angle` [rad, from 0.1 deg to pi] about `axis` (unit) through `point` [m]; world.

    Raises:
        SceneError: on construction, when a number is out of its domain. An axis that is not of unit length is normalised.
    """

    angle: float
    axis: Float[np.ndarray, "3"]
    point: Float[np.ndarray, "3"]

    def __post_init__(self) -> None:
        for name, value in _checked(self.angle, self.axis, self.point).items():
            object.__setattr__(self, name, value)

    def transform(self, angle: float) -> Float[np.ndarray, "4 4"]:
        """Return the rigid transform of a turn by `angle` [rad] about this axis."""
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(angle * self.axis).as_matrix()
        T[:3, 3] = self.point - T[:3, :3] @ self.point
        return T

    def moved(self, T: Float[np.ndarray, "4 4"]) -> Turn:
        """Return the turn of a body that, with everything around it, is moved by the rigid transform T."""
        return Turn(self.angle, T[:3, :3] @ self.axis, T[:3, :3] @ self.point + T[:3, 3])

    def distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, " point"]:
        """Return the distances of points from the axis [m]."""
        return np.linalg.norm(np.cross(points - self.point, self.axis), axis=1)

    def to_json(self) -> dict[str, Any]:
        """Return the turn as it stands in scene.json."""
        return {"angle": float(self.angle), "axis": self.axis.tolist(), "point": self.point.tolist()}

    @classmethod
    def from_json(cls, value: Any) -> Turn:
        """Read what `to_json` wrote, trusting nothing in it; SceneError."""
        if not isinstance(value, dict) or set(value) != {"angle", "axis", "point"}:
            raise SceneError(f"turn is {quote(value)}; expected null or an object with angle [rad], axis and point [m]")
        return cls(**_checked(**value))


def check_asked(*, turn_deg: Any, tip_deg: Any, about: Any) -> bool:
    """Return whether a turn is asked for; SceneError where it is none, or contradicts another option."""
    if turn_deg is not None and tip_deg is not None:
        raise SceneError("`turn_deg` and `tip_deg` are both given; expected one of them")
    if about is not None and turn_deg is None:
        if tip_deg is not None:
            raise SceneError("`about` is given with `tip_deg`; leave it out: a tip is over the edge of the support")
        raise SceneError("`about` needs `turn_deg`, the angle of the turn; add it, or leave `about` out")
    for name, degrees, either in (("turn_deg", turn_deg, ", either way"), ("tip_deg", tip_deg, "")):
        if degrees is None:
            continue
        number = isinstance(degrees, Real) and not isinstance(degrees, bool)
        if not number or not LEAST_TURN <= (abs(degrees) if either else degrees) <= HALF_TURN:
            raise SceneError(f"`{name}` is {quote(degrees)}; expected {LEAST_TURN:g} to {HALF_TURN:g} degrees{either}")
    if about is not None:
        turn_point(about)
    return turn_deg is not None or tip_deg is not None


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of an object as rigid transforms along one way: the turn's arc, then the slide.

    Attributes:
        turn: None where the object only slides.
        direction: unit vector of the slide, world.
        slide_length: [m].
        radius: greatest distance of a point of the object from the turn's axis [m]: its arc is the way of the turn.
    """

    turn: Turn | None
    direction: Float[np.ndarray, "3"]
    slide_length: float
    radius: float = 0.0

    @property
    def turn_length(self) -> float:
        """Way of the turn [m]."""
        return self.turn.angle * self.radius if self.turn else 0.0

    @property
    def length(self) -> float:
        """The whole way [m]."""
        return self.turn_length + self.slide_length

    @property
    def beginnings(self) -> list[float]:
        """Ways [m] at which the turn and the slide begin, as far as there are such."""
        stages = [(0.0, self.turn_length), (self.turn_length, self.slide_length)]
        return [start for start, length in stages if length > 0]

    @property
    def beginning_twists(self) -> list[Twist]:
        """Twists with which the turn and the slide begin, of the object as it lies before both."""
        return [self.twist(way).moved(np.linalg.inv(self.displacement(way))) for way in self.beginnings]

    def moved(self, T: Float[np.ndarray, "4 4"]) -> Motion:
        """Return the motion of an object that, with everything around it, is moved by the rigid transform T."""
        turn = self.turn.moved(T) if self.turn else None
        return replace(self, turn=turn, direction=T[:3, :3] @ self.direction)

    def parts(self, way: float) -> list[float]:
        """Return how much of `way` [m] belongs to each stage that it comes to."""
        turn = min(way, self.turn_length) if self.slide_length else way
        return [way] if self.turn is None else [part for part in (turn, way - turn) if part > 0]

    def angle(self, way: float) -> float:
        """Return by how much the object has turned after `way` [rad]; beyond the ends it goes on."""
        if self.turn is None:
            return 0.0
        if self.slide_length and way >= self.turn_length:
            return self.turn.angle
        return way / self.radius

    def slid(self, way: float) -> float:
        """Return how far the object has slid after `way` [m]; beyond the ends it goes on."""
        if self.turn is None:
            return way
        return max(0.0, way - self.turn_length) if self.slide_length else 0.0

    def displacement(self, way: float) -> Float[np.ndarray, "4 4"]:
        """Return the rigid transform (world) that carries the object from where it lies to where it is after `way` [m].

        The pose there is this transform times T_world_object. Before 0 and beyond `length` the stage there goes on.
        """
        T = self.turn.transform(self.angle(way)) if self.turn else np.eye(4)
        T[:3, 3] += self.slid(way) * self.direction
        return T

    def twist(self, way: float = 0.0) -> Twist:
        """Return the twist after `way` [m]; where the turn ends, that of the slide."""
        if self.turn is not None and (way < self.turn_length or self.slide_length == 0):
            angular = self.turn.axis / self.radius
            return Twist(-np.cross(angular, self.turn.point), angular)
        return Twist(self.direction, np.zeros(3))


def unit_motion(value: Any) -> Float[np.ndarray, "3"]:
    """Return `value` as a unit vector; SceneError when it is zero, not finite, or not three real numbers."""
    try:
        motion = real_numbers(value)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise SceneError(f"motion is not a vector of numbers; expected three ({error})") from error
    if motion.shape != (3,):
        raise SceneError(f"motion has shape {motion.shape}; expected three numbers (dx, dy, dz)")
    largest = float(np.abs(motion).max())
    if not 0 < largest < np.inf:
        raise SceneError(
            f"motion is ({motion[0]:g}, {motion[1]:g}, {motion[2]:g}); expected a finite direction that is not zero, "
            "such as (1, 0, 0)"
        )
    return unit_vector(motion)


def three_numbers(name: str, value: Any) -> Float[np.ndarray, "3"]:
    """Return a value as three finite numbers; SceneError with its name where it is none."""
    try:
        vector = real_numbers(value)
    except (TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise SceneError(f"{name} is {quote(value)}; expected three numbers") from error
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise SceneError(f"{name} is {quote(value)}; expected three finite numbers")
    return vector


def _checked(angle: Any, axis: Any, point: Any) -> dict[str, Any]:
    """Return what a `Turn` consists of, by name; SceneError where it makes none."""
    given = angle.item() if isinstance(angle, np.generic) else angle
    number = isinstance(given, Real) and not isinstance(given, bool)
    if not number or not SMALLEST_TURN <= given <= LARGEST_TURN:
        raise SceneError(
            f"the angle of a turn is {quote(given)}; expected a number of radians from {SMALLEST_TURN:.3g} (0.1 deg) to pi; "
            "turn the other way round for more, or by the opposite axis for less than 0"
        )
    direction = three_numbers("the axis of a turn", axis)
    if not direction.any():
        raise SceneError("the axis of a turn is zero; expected a direction, such as (0, 0, 1)")
    return {"angle": float(given), "axis": unit_vector(direction), "point": turn_point(point)}


def turn_point(value: Any) -> Float[np.ndarray, "3"]:
    """Return a point of a turn's axis [m, world]; SceneError where it is none, or in no room."""
    point = three_numbers("the point of a turn", value)
    if np.abs(point).max() > FARTHEST:
        raise SceneError(
            f"the point of a turn is {quote(value)}; expected metres, at most {FARTHEST:g} from the origin"
        )
    return point
