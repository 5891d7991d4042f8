"""What a story of slide, grasp and lift came to."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.simulation.episode import Trace


@dataclass(frozen=True)
class Try:
    """One try.

    phase: where it failed, of "slide", "grasp search", "approach", "lift", "hold"; "" where the object was lifted and held.
    configuration: of the folder, that slid the object; -1 where it lay graspable already. overhang: free part of the
    object's length after the slide. grasps: found, of `drawn` draws so far. drift: of the grasp taken. raised, least_held
    [m], turned_deg, hand_environment [m]: see `LiftVerdict`. NaN or -1 where it did not come to that.
    """

    number: int
    phase: str
    reason: str
    configuration: int = -1
    overhang: float = float("nan")
    grasps: int = -1
    drawn: int = -1
    drift: float = float("nan")
    raised: float = float("nan")
    least_held: float = float("nan")
    turned_deg: float = float("nan")
    hand_environment: float = float("nan")

    @property
    def success(self) -> bool:
        """Lifted and held."""
        return not self.phase

    def as_json(self) -> dict[str, Any]:
        """`success` and the attributes as JSON can hold them: null for NaN."""
        values = {"success": self.success, **asdict(self)}
        return {
            name: None if isinstance(value, float) and math.isnan(value) else value for name, value in values.items()
        }


@dataclass(frozen=True)
class Story:
    """All tries, at least one, and the trace of the whole simulation; None where nothing could be played.

    ended: why there were no more tries, "" for success or because their number was reached. last_state: MuJoCo's
    integration state at the last record before a divergence, None without one.
    """

    tries: list[Try]
    trace: Trace | None
    ended: str
    last_state: Float[np.ndarray, " state"] | None
