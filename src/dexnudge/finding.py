"""What is found out about a scene or a hand before anything is sampled, in one form for people and programs."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

Level = Literal["error", "warning", "note"]


@dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes:
        level: "error" where no configuration can be verified as the scene stands, "warning" where what was understood may
            not be what is meant, "note" for what was understood.
        what: what it is about: "size", "units", "pose", "motion", "supports", "carried", "clearance", "fingers",
            "free_way", or "repaired"; of a hand "palm", "base_link", "geometry", "fingertips", "palm_normal", "description",
            "joints", "limits", "self_collision", "closing" or "surfaces".
        sentence: what was found: what, where, expected, got.
        remedy: what to do about it, naming arguments in backticks; "" for a note, unless it is an assumption.
    """

    level: Level
    what: str
    sentence: str
    remedy: str = ""

    def __str__(self) -> str:
        return f"{self.level}: {self.message}"

    @property
    def message(self) -> str:
        """Sentence and remedy in one, as errors of this package have them."""
        return f"{self.sentence}; {self.remedy}" if self.remedy else self.sentence

    def as_dict(self) -> dict[str, Any]:
        """Return the fields, for JSON."""
        return asdict(self)


def vector_text(metres: Float[np.ndarray, "3"], *, digits: int = 4) -> str:
    """Return a place or a way [m] as messages show it."""
    return f"({', '.join(f'{each:.{digits}f}' for each in metres.round(digits) + 0.0)})"  # no -0.0000


def length_text(metres: float) -> str:
    """Return a length in the unit in which people would say it."""
    return f"{1e3 * metres:.1f} mm" if metres < 1 else f"{metres:.3g} m"


def direction_text(way: Float[np.ndarray, "3"]) -> str:
    """Return where a way leads, seen from an object: "below it", "above it" or "beside it"."""
    steep = abs(way[2]) > np.linalg.norm(way[:2])
    return "beside it" if not steep else "below it" if way[2] < 0 else "above it"


KNOWN_TO = 0.05  # what the fit of a probability to some hundred pushes tells apart, at best


def probability_text(probability: float) -> str:
    """Return a probability in words, as finely as it is known: "85%", to 5 %; never as certain, but as ">95%" or "<5%"."""
    steps, most = round(probability / KNOWN_TO), round(1 / KNOWN_TO)
    sign = ">" if steps >= most else "<" if steps <= 0 else ""
    return f"{sign}{min(max(steps, 1), most - 1) * KNOWN_TO:.0%}"
