"""What a story of slide, grasp and lift came to."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from dexnudge.simulation.episode import Trace


@dataclass(frozen=True)
class Try:
    """One try.

    phase: where it failed, of "slide", "grasp search", "approach", "lift", "hold"; "" where the object was lifted and held.
    configuration: of the folder, that slid the object; -1 where it lay graspable already. overhang: free part of the
    object's length after the slide. grasps: found, of `drawn` draws so far. drift: of the grasp taken. raised, least_held
    [m], turned_deg, hand_environment [m]: see `LiftVerdict`. None or -1 where it did not come to that.
    """

    number: int
    phase: str
    reason: str
    configuration: int = -1
    overhang: float | None = None
    grasps: int = -1
    drawn: int = -1
    drift: float | None = None
    raised: float | None = None
    least_held: float | None = None
    turned_deg: float | None = None
    hand_environment: float | None = None

    @property
    def success(self) -> bool:
        """Lifted and held."""
        return not self.phase


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
