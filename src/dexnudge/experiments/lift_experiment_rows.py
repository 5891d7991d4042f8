"""Lines of an experiment's `lifted/results.jsonl`: what came of sliding, grasping and lifting each object."""

import re
from dataclasses import dataclass, field
from typing import Any, Literal

from dexnudge.execution.slide_grasp_lift import Try
from dexnudge.experiments.experiment_lines import UNVERIFIED
from dexnudge.experiments.experiment_rows import PhysicsRow

FAILED = "object failed"
KINDS = {
    "it would tip first": "would tip before it is graspable",
    "it would hang over too far": "would hang over too far",
    "no edge within reach": "no edge within reach",
    "something is in the way": "something is in the object's way",
    "no longer fits": "no configuration fits any more",
    "of the folder is left": "no configuration left",
    "approach blocked": "approach blocked",
    "short of": "stopped short",
    "the object tipped": "tipped",
    "into the environment": "hand in surroundings",
    "no grasp found": "none found",
    "slipped on lift": "slipped",
    "dropped in hold": "dropped",
}
"""What stands in the reason of a try -> what it is counted as; the first that does."""


@dataclass(frozen=True, kw_only=True)
class LiftRow(PhysicsRow):
    """The story of slide, grasp and lift with its verified draws.

    Attributes:
        status: "played", also where a try ended before anything moved; "failed" when the object could not be read, does
            not fit its scene, MuJoCo cannot take it, no draw is verified, or a worker process died.
        tries: in their order, none where it failed; objects of `Try`, or dicts with its fields.
        ended: why there were no more tries, see `story.Story`.
        simulated: time in the simulation [s].
    """

    status: Literal["played", "failed"]
    tries: list[Any] = field(default_factory=list)
    ended: str = ""
    simulated: float = 0.0

    def __post_init__(self) -> None:
        made = [one if isinstance(one, Try) else Try(**one) for one in self.tries]
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
        return "" if one.success else f"{one.phase}: {_kind(one.reason)}"


def _kind(reason: str) -> str:
    """As in `KINDS`; else what stands before the first colon or figure."""
    own = re.split(r"[:\d]", reason)[0].strip()
    return next((kind for text, kind in KINDS.items() if text in reason), own)
