"""What is not known for certain about a scene: ranges of frictions, mass and force, and how far off the object may lie."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError, check_integer, check_seed, did_you_mean, quote

FACTORS = {  # which number of a scene each range is a factor on
    "friction": "friction_hand",
    "friction_environment": "friction_environment",
    "mass": "mass",
    "max_normal_force": "max_normal_force",
}
WEAKEST = ("friction", "max_normal_force")  # the motion is hardest to make where these are least, the others greatest
LARGEST_FACTOR = 100.0  # farther off, the scene's own number is in another unit
LARGEST_POSE = {"pose_mm": 50.0, "pose_deg": 45.0, "height_mm": 10.0}  # farther off, the object lies elsewhere
MOST_WORLDS = 1024
LARGEST_INTEGER = 1e18  # no value is this large, and one of hundreds of digits is no float
CERTAIN = (1.0, 1.0)
EXPECTED = "expected KEY=VALUE, such as friction=0.5..1 or pose_mm=2"


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """The worlds that a configuration should hold in, beside the one that the scene describes.

    Attributes:
        friction: least and greatest factor on `friction_hand`.
        friction_environment, mass, max_normal_force: the same on these numbers of the scene.
        pose_mm: largest displacement of the object along its support [mm].
        pose_deg: largest turn about the vertical through its centre of mass, to either side [deg].
        height_mm: largest displacement off its support, to either side [mm].
        worlds: number of worlds that are sampled, evenly spread (Sobol).
        seed: of these.

    Raises:
        InputError: on construction, when a range is empty or reversed, or a number is out of its domain.
    """

    friction: tuple[float, float] = CERTAIN
    friction_environment: tuple[float, float] = CERTAIN
    mass: tuple[float, float] = CERTAIN
    max_normal_force: tuple[float, float] = CERTAIN
    pose_mm: float = 0.0
    pose_deg: float = 0.0
    height_mm: float = 0.0
    worlds: int = 16
    seed: int = 0

    def __post_init__(self) -> None:
        for name in KEYS:
            object.__setattr__(self, name, _checked(name, getattr(self, name)))

    @classmethod
    def parse(cls, words: Iterable[str]) -> Uncertainty:
        """Return what words such as friction=0.5..1, mass=0.5..2 and pose_mm=2 say.

        Raises:
            InputError: a word without "=", a key that is unknown or given twice, or a value that is out of its domain.
        """
        given: dict[str, Any] = {}
        for word in words:
            name, equals, value = word.partition("=")
            if not equals:
                raise InputError(f"`uncertain` got {quote(word)}; {EXPECTED}")
            _check_keys([name])
            if name in given:
                raise InputError(f"`uncertain` names {name} twice; expected each key once")
            numbers: Any = [_number(part) for part in value.split("..")]
            numbers = numbers if name in FACTORS or len(numbers) > 1 else numbers[0]
            given[name] = _checked(name, numbers, shown=value if name in FACTORS else None)
        return cls(**given)

    def to_json(self) -> dict[str, Any]:
        """Return the uncertainty as it stands in scene.json."""
        return asdict(self)

    @classmethod
    def from_json(cls, value: Any) -> Uncertainty:
        """Read what `to_json` wrote, trusting nothing in it; InputError."""
        if not isinstance(value, dict):
            raise InputError(f"`uncertain` is {quote(value)}; expected an object with {', '.join(KEYS)}")
        _check_keys(value)
        return cls(**{name: _checked(name, each) for name, each in value.items()})

    @property
    def disturbs(self) -> bool:
        """Whether frictions, mass or force may be other than the scene's."""
        return any(getattr(self, name) != CERTAIN for name in FACTORS)

    @property
    def displaces(self) -> bool:
        """Whether the object may lie elsewhere."""
        return any(getattr(self, name) > 0 for name in LARGEST_POSE)

    def hardest(self, scene: Any) -> dict[str, Any]:
        """Return the numbers of the scene where the motion is hardest to make: slippery hand, rough and heavy object."""
        return {
            number: getattr(self, name)[name not in WEAKEST] * getattr(scene, number)
            for name, number in FACTORS.items()
        }

    def sampled(self, scene: Any) -> list[tuple[dict[str, Any], Float[np.ndarray, "3"], float]]:
        """Return of each world the scene's numbers there, and the displacement [m] and the turn [rad] of the object.

        The displacement is along two axes of the support, evenly over a disk, and off it. Frictions, mass and force of the
        last world are the hardest, of the others spread evenly over their ranges.
        """
        from scipy.stats import qmc  # takes half a second

        ranges = {FACTORS[name]: np.multiply(getattr(self, name), getattr(scene, FACTORS[name])) for name in FACTORS}
        sides = np.array([*ranges.values(), (0.0, 1.0), (0.0, 2 * np.pi), (-1.0, 1.0), (-1.0, 1.0)])
        spread = qmc.Sobol(len(sides), seed=self.seed).random_base2((self.worlds - 1).bit_length())[: self.worlds]
        found = []
        for *numbers, area, angle, off, turn in (sides[:, 0] + spread * np.ptp(sides, axis=1)).tolist():
            along = self.pose_mm * np.sqrt(area)
            displacement = 1e-3 * np.array([along * np.cos(angle), along * np.sin(angle), self.height_mm * off])
            found.append(
                (dict(zip(ranges, numbers, strict=True)), displacement, float(np.radians(self.pose_deg * turn)))
            )
        found[-1] = (self.hardest(scene), *found[-1][1:])
        return found


KEYS = tuple(field.name for field in fields(Uncertainty))


def _check_keys(names: Iterable[str]) -> None:
    for name in names:
        if name not in KEYS:
            raise InputError(
                f"`uncertain` has no key {quote(name)}{did_you_mean(name, KEYS)}; expected some of {', '.join(KEYS)}"
            )


def _checked(name: str, value: Any, *, shown: str | None = None) -> Any:
    """Return the value of a key, of the right type; InputError, quoting `shown` or it, where it is out of its domain."""
    if name == "worlds":
        check_integer(name, value, least=1, most=MOST_WORLDS)
        return int(value)
    if name == "seed":
        check_seed(value)
        return int(value)
    if (most := LARGEST_POSE.get(name)) is not None:
        if not _is_number(value) or not 0 <= value <= most:
            raise InputError(f"the {name} of `uncertain` is {quote(value)}; expected a number from 0 to {most:g}")
        return float(value)
    ends = tuple(value) if isinstance(value, list | tuple) else ()
    given = value if shown is None else shown
    if len(ends) != 2 or not all(map(_is_number, ends)) or not 0 < ends[0] <= ends[1] <= LARGEST_FACTOR:
        raise InputError(
            f"the {name} of `uncertain` is {quote(given)}; expected LEAST..MOST, factors on the scene's own above 0 and at "
            f"most {LARGEST_FACTOR:g}, the least first, such as 0.5..1"
        )
    return float(ends[0]), float(ends[1])


def _number(text: str) -> int | float | str:
    """Return the number that a text is, or the text."""
    for kind in () if "_" in text else (int, float):  # Python's own way to group digits
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < LARGEST_INTEGER
