"""Lines of an experiment's `executed/results.jsonl`: what came of executing the best of each object, scene and method."""

from dataclasses import dataclass, field
from typing import Any, Literal

from dexnudge.experiments.rows import RowKey


@dataclass(frozen=True, kw_only=True)
class Executed:
    """One executed configuration.

    Attributes:
        rank: place among the verified draws, 0 the best.
        force_margin: at most 3. links: number of hand links that touch. behaviour: push, press or hook.
        success, reason, advanced [m], turned_deg, sunk [m], hand_environment [m]: see `simulation.success`.
        cone_share: of the hand's friction that the forces use.
        approach: name of the planner that found a way to contact, "" where there was none.
        changed: success where a friction or the mass is other than was planned for, by setting; empty where not played.
    """

    rank: int
    force_margin: float
    links: int
    behaviour: str
    success: bool
    reason: str
    advanced: float
    turned_deg: float
    sunk: float
    hand_environment: float
    cone_share: float
    approach: str
    changed: dict[str, bool] = field(default_factory=dict)

    @property
    def kind_of_failure(self) -> str:
        """Name of the outcome in words; "" for a success."""
        return self.reason


@dataclass(frozen=True, kw_only=True)
class PhysicsRow:
    """What came in physics of one object in one scene with one method.

    Attributes:
        reason: why it failed; empty where it did not.
        seed: of scene, draws, and grasps where there are any.
        drawn, verified: draws, and how many of them are verified.
        seconds: by stage.
    """

    object: str
    scene: str
    method: str
    reason: str = ""
    seed: int
    drawn: int = 0
    verified: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def key(self) -> RowKey:
        """What identifies the row within an experiment."""
        return (self.object, self.scene, self.method)


@dataclass(frozen=True, kw_only=True)
class ExecutionRow(PhysicsRow):
    """Its best verified draws, executed.

    Attributes:
        status: "executed", also where no draw was verified; "failed" when the object could not be read, does not fit its
            scene, MuJoCo cannot take it, or a worker process died.
        configurations: the executed ones, best first; objects of `Executed`, or dicts with its fields.
    """

    status: Literal["executed", "failed"]
    configurations: list[Any] = field(default_factory=list)

    def __post_init__(self) -> None:
        made = [each if isinstance(each, Executed) else Executed(**each) for each in self.configurations]
        object.__setattr__(self, "configurations", made)

    @property
    def top_succeeded(self) -> bool:
        """Whether the best verified draw, the one that a robot would use, was there and did what it should."""
        return any(each.success for each in self.configurations if each.rank == 0)
