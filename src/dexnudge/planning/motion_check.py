"""Whether a hand can move straight from one state to another without touching anything."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from dexnudge.planning.hand_clearance import CAP, NO_STOP, Clearances, HandClearance
from dexnudge.planning.hand_states import State, States, StateSpace, between, matrices

CLEARANCE = 0.003  # [m] asked for at every state that is looked at
ASSURED = 0.0005  # [m] what is left of it between them, by the bound on how far any point of the hand moves


@dataclass(frozen=True)
class MotionCheck:
    """Straight motions, checked so finely that nothing can slip through.

    A state with clearance c vouches for all states that no point of the hand moves farther than c to; where that is not
    enough to cover the motion, its halves are looked at. States next to each other are at most 2 (clearance - 0.5 mm)
    apart, 5 mm, in the motion of the hand's fastest point, whatever the clearance.
    """

    space: StateSpace
    measure: HandClearance
    clearance: float = CLEARANCE

    def clearances(self, states: States, *, stop: float = NO_STOP) -> Clearances:
        """Least distances to environment and object; see `HandClearance`."""
        return self.measure(states[:, :3], matrices(states), self.space.joint_angles(states[:, 7]), stop=stop)

    def states_free(self, states: States) -> Bool[np.ndarray, " n"]:
        """Which states keep the clearance."""
        return self.clearances(states, stop=self.clearance).distance.min(axis=1) >= self.clearance

    def free(self, start: State, end: State) -> bool:
        """Whether the whole straight motion keeps the clearance; both ends are looked at."""
        return self.blocked_at(start, end) is None

    def blocked_at(self, start: State, end: State) -> float | None:
        """None where the motion is free; otherwise a fraction of it at which the clearance is not kept.

        The coarsest state that shows the obstacle, not the first along the way.
        """
        way = self.space.displacement(start, end)
        ends = self.states_free(between(start, end, np.array([1.0, 0.0])))
        if not ends.all():
            return 0.0 if not ends[1] else 1.0
        slack = self.clearance - ASSURED
        middle, half = np.array([0.5]), 0.5
        while len(middle):
            distance = self.clearances(between(start, end, middle), stop=self.clearance).distance.min(axis=1)
            if distance.min() < self.clearance:
                return float(middle[np.argmin(distance)])
            needed = half * way
            if needed <= slack:
                return None
            open_yet = middle[np.minimum(distance, CAP) < needed + ASSURED]
            half /= 2
            middle = np.concatenate([open_yet - half, open_yet + half])
        return None
