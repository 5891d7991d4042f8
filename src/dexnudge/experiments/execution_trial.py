"""Execution: the best verified draws of a trial, each played out in physics on its own."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from dexnudge.execution.executor import Alternatives, Execution, Executor, distinct_pushes
from dexnudge.experiments.disturbances import AS_DRAWN, EXECUTED_AT, curves_of, setting_name
from dexnudge.experiments.metrics import (
    FAILED,
    OBJECTS,
    UNVERIFIED,
    GroupRate,
    Metric,
    group_rates,
    mean,
    number_with,
    share,
    share_of,
)
from dexnudge.experiments.records import TrialRecord
from dexnudge.experiments.tables import factor_chart, group_table, interval_chart
from dexnudge.experiments.trial import DrawnTrial, Section, TrialSampler
from dexnudge.planning.approach import Approach
from dexnudge.planning.outcomes import Outcome
from dexnudge.results.samples import Samples
from dexnudge.simulation.feedback import Feedback
from dexnudge.simulation.model import SimulationModel, changed_physics, scene_model
from dexnudge.simulation.open_loop import OpenLoop
from dexnudge.synthesis.acceptance import behaviour_along

WITH_ERRORS, OPEN_LOOP = "With friction and mass errors", "open loop"
MARGIN_EDGES = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0)  # of the bins of force margins
MARGIN_BINS = [*(f"{low:g} to {high:g}" for low, high in pairwise(MARGIN_EDGES)), "3 (cap)"]
ABOUT_GROUPS = {
    "By force margin": "The largest factor, at most 3, on the surroundings' friction at which the forces balance.",
    WITH_ERRORS: "The top-ranked draws once more, with one quantity of the physics multiplied, while approach and forces "
    "were planned for its nominal value; with feedback also without it (open loop). n is how many were played so.",
}


@dataclass(frozen=True)
class ExecutedDraw:
    """One executed configuration.

    Attributes:
        rank: place among the verified draws, 0 the best. began_with: the same of the one with which the push began, another
            where no free way led to that or it did not hold when rehearsed; margin, links and behaviour are of it.
        force_margin: at most 3. links: number of hand links in contact. behaviour: push, press or hook.
        outcome: value of an `Outcome`. length_asked, length_reached [m], turned_deg, sunk [m], hand_environment [m],
            link_force [N]: see `simulation.success.PushVerdict`.
        cone_share: of the hand's friction that the forces use.
        approach: name of the planner that found a way to contact, "" where there was none.
        disturbed: success where a friction or the mass is other than was planned for, by setting; empty where not played.
    """

    rank: int
    force_margin: float
    links: int
    behaviour: str
    outcome: str
    length_asked: float
    length_reached: float
    turned_deg: float
    sunk: float
    hand_environment: float
    link_force: float
    cone_share: float
    approach: str
    began_with: int | None = None  # records of earlier versions lack it
    disturbed: dict[str, bool] = field(default_factory=dict)

    @property
    def success(self) -> bool:
        """Whether the object was pushed to where it should be."""
        return self.outcome == Outcome.SUCCESS.value


@dataclass(frozen=True, kw_only=True)
class ExecutionRecord(TrialRecord):
    """The best verified draws of a trial, executed; best first."""

    kind: ClassVar[str] = "execution"

    executed: list[ExecutedDraw] = field(default_factory=list)

    @property
    def top(self) -> ExecutedDraw | None:
        """The best verified draw, the one that a robot would use; None where there is none."""
        return next((each for each in self.executed if each.rank == 0), None)

    @property
    def pushes(self) -> list[ExecutedDraw]:
        """The executed draws without those whose push began with the same draw as a better one's, and was the same."""
        began_with = [each.rank if each.began_with is None else each.began_with for each in self.executed]
        return [self.executed[place] for place in distinct_pushes(began_with)]

    @property
    def succeeded(self) -> bool:
        """Whether the best verified draw is there and succeeds."""
        return self.top is not None and self.top.success


Records = Sequence[ExecutionRecord]


def margin_bin(margin: float) -> str:
    """Return the bin of a verified draw's force margin: its lower edge belongs to it, its upper one to the next."""
    return MARGIN_BINS[int(np.searchsorted(MARGIN_EDGES, margin, side="right")) - 1]


GROUPS: dict[str, Callable[[ExecutedDraw], list[tuple[str, bool]]]] = {  # title -> (group, success) of an executed draw
    "By force margin": lambda each: [(margin_bin(each.force_margin), each.success)],
    "By behaviour": lambda each: [(each.behaviour, each.success)],
    "By links in contact": lambda each: [(f"{each.links:2d}", each.success)],
    "By approach": lambda each: [("found" if each.approach else "none, starts at contact", each.success)],
    WITH_ERRORS: lambda each: [(AS_DRAWN, each.success), *each.disturbed.items()] if each.disturbed else [],
}


def rates_by(title: str, records: Records) -> Mapping[str, Mapping[str, GroupRate]]:
    """Return the rates of the executed draws by scene and group of `GROUPS`."""
    return group_rates(records, lambda record: [pair for each in record.pushes for pair in GROUPS[title](each)])


def _outcomes(records: Records) -> dict[str, int]:
    """Executed draws that fail by outcome, and objects of which none could be executed."""
    counts = Counter(each.outcome.replace("_", " ") for one in records for each in one.pushes if not each.success)
    counts["object failed"] += number_with("failed")(records)
    counts["no draw verified"] += number_with("unverified")(records)
    return {name: count for name, count in counts.most_common() if count}


@dataclass(frozen=True)
class ExecutionTrial(DrawnTrial[ExecutionRecord]):
    """Execute the best verified draws.

    num: of them, best first. errors: whether the best one is also played in the physics of `EXECUTED_AT`.
    feedback: whether the hand answers what it feels and sees.
    """

    title: ClassVar[str] = "Executed in physics"
    about: ClassVar[str] = (
        "Top-ranked: % of all attempted objects whose best verified draw, the one that a robot would use, succeeds in "
        "physics. Length asked and reached: of the push, mean over top-ranked draws. Executed: the first verified draws of "
        "each, and the share of them that succeeds; one to which no free way leads, or whose turn did not hold when it was "
        "rehearsed, and whose push began with another of them, counts once with that. In brackets, 95 % intervals by "
        "bootstrap over objects."
    )
    folder: ClassVar[str] = "executed"
    record: ClassVar[type[ExecutionRecord]] = ExecutionRecord
    metrics: ClassVar[Sequence[Metric]] = (
        OBJECTS,
        FAILED,
        UNVERIFIED,
        Metric("top", share(lambda each: each.succeeded), "top-ranked"),
        Metric("length_asked_mm", mean(lambda each: each.top and 1e3 * each.top.length_asked), "length asked, mm", 0),
        Metric("length_reached_mm", mean(lambda each: each.top and 1e3 * each.top.length_reached), "reached, mm", 0),
        Metric("executed", lambda records: sum(len(one.pushes) for one in records), "executed", 0),
        Metric("single", share_of(lambda each: [one.success for one in each.pushes]), "of these"),
        Metric("outcomes", _outcomes, "Why executions failed", "counts"),
    )
    rate: ClassVar[str] = "top"

    num: int = 1
    errors: bool = False
    feedback: bool = True

    def start_with(self, sampler: TrialSampler) -> Callable[[Samples, int], dict[str, Any]]:
        """Return what plays the best verified draws of a trial."""

        def play(samples: Samples, _: int) -> dict[str, Any]:
            simulation = scene_model(sampler.hand, samples.scene)
            policy = Feedback() if self.feedback else OpenLoop()
            executor, verified = Executor(samples.scene, simulation, policy), samples.verified
            ranks = range(min(self.num, len(verified)))
            return {"executed": [self._executed(rank, verified, executor, simulation) for rank in ranks]}

        return play

    def sections(self, records: Records) -> list[Section]:
        """Return rates by force margin, behaviour, contacts and approach, and with errors where there are some."""
        found = []
        for title in GROUPS:
            rates, chart = rates_by(title, records), None
            if title == "By force margin":
                bars = {
                    scene: {f"{label}, n = {group.number}": group.rate for label, group in groups.items()}
                    for scene, groups in rates.items()
                    if len(rates) > 2 or scene != "all"  # which is the only scene then
                }
                chart = ("calibration.png", partial(interval_chart, title, bars))
            if title == WITH_ERRORS and rates["all"]:
                panels = curves_of({name: group.rate for name, group in rates["all"].items()})
                chart = ("worlds.png", partial(factor_chart, "Executed in other worlds than planned", panels))
            if rates["all"]:
                table = group_table(title.partition(" ")[2], rates)
                found.append(Section(title, ABOUT_GROUPS.get(title, ""), table, chart, numbers=rates))
        return found

    def _executed(self, rank: int, verified: Samples, executor: Executor, simulation: SimulationModel) -> ExecutedDraw:
        q = verified.q.astype(np.float64)
        others = np.delete(q, rank, axis=0) if self.feedback else None
        execution = executor(q[rank], others)
        began_with = execution.number_of_first(rank)
        sample, verdict = verified[began_with], execution.verdict
        root = q[began_with, :3] - sample.scene.object_in_world().center_mass
        errors = self.errors and rank == 0
        return ExecutedDraw(
            rank=rank,
            force_margin=round(sample.force_margin, 4),
            links=len(sample.contact_links),
            behaviour=behaviour_along(sample.contacts, sample.scene.motion, root),
            outcome=verdict.outcome.value,
            length_asked=round(verdict.length_asked, 5),
            length_reached=round(verdict.length_reached, 5),
            turned_deg=round(verdict.turned_deg, 3),
            sunk=round(verdict.sunk, 5),
            hand_environment=round(verdict.hand_environment, 6),
            link_force=round(verdict.link_force, 3),
            cone_share=float(execution.forces.cone_share[0]),
            approach=execution.approach.planner if isinstance(execution.approach, Approach) else "",
            began_with=began_with,
            disturbed=self._disturbed(q[rank], executor, execution, simulation, others) if errors else {},
        )

    def _disturbed(
        self,
        q: Float[np.ndarray, " coordinates"],
        executor: Executor,
        execution: Execution,
        simulation: SimulationModel,
        others: Alternatives,
    ) -> dict[str, bool]:
        """Return success in other worlds; of feedback also without it, in the planned world, too."""
        worlds = {setting_name(*each): changed_physics(simulation, **dict([each])) for each in EXECUTED_AT}
        found = {name: executor.again(q, execution, world, others).success for name, world in worlds.items()}
        if self.feedback:
            alone = executor.with_policy(OpenLoop())
            for name, world in {AS_DRAWN: simulation, **worlds}.items():
                found[f"{name}, {OPEN_LOOP}"] = alone.again(q, execution, world).success
        return found
