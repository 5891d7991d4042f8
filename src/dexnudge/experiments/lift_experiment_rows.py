"""Lines of an experiment's `lifted/results.jsonl`: what came of sliding, grasping and lifting each object."""

from dataclasses import dataclass, field
from typing import Any, Literal

from dexnudge.execution.slide_grasp_lift import Attempt
from dexnudge.experiments.experiment_lines import UNVERIFIED
from dexnudge.experiments.experiment_rows import PhysicsRow

FAILED = "object failed"


@dataclass(frozen=True, kw_only=True)
class LiftRow(PhysicsRow):
    """The story of slide, grasp and lift with its verified draws.

    Attributes:
        status: "played", also where a try ended before anything moved; "failed" when the object could not be read, does
            not fit its scene, MuJoCo cannot take it, no draw is verified, or a worker process died.
        tries: in their order, none where it failed; objects of `Attempt`, or dicts with its fields.
        ended: why there were no more tries, see `SlideGraspLiftResult`.
        simulated: time in the simulation [s].
    """

    status: Literal["played", "failed"]
    tries: list[Any] = field(default_factory=list)
    ended: str = ""
    simulated: float = 0.0

    def __post_init__(self) -> None:
        made = [one if isinstance(one, Attempt) else Attempt.from_json(one) for one in self.tries]
        object.__setattr__(self, "tries", made)

    @property
    def lifted(self) -> bool:
        """Whether the object was lifted and held, at whichever try."""
        return any(one.success for one in self.tries)

    @property
    def lifted_at_first(self) -> bool:
        """Whether the first try did."""
        return bool(self.tries) and self.tries[0].success

    def failure_of(self, number: int) -> str:
        """Phase and kind of reason of a try (0 the first, -1 the last); "" for a success."""
        if self.status == "failed":
            return UNVERIFIED if self.reason == UNVERIFIED else FAILED
        one = self.tries[number]
        return "" if one.success else f"{one.phase}: {one.outcome.value.replace('_', ' ')}"
