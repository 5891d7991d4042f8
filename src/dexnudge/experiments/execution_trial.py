"""Execution: the best verified draws of a trial, each played out in physics on its own."""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from dexnudge.execution.executor import Executor
from dexnudge.experiments.charts import calibration_chart
from dexnudge.experiments.config import ExperimentConfig, TrialKey, trial_seed
from dexnudge.experiments.disturbances import AS_DRAWN, EXECUTED_AT, setting_name, setting_text
from dexnudge.experiments.metrics import FAILED, OBJECTS, UNVERIFIED, GroupRate, Metric, group_rates
from dexnudge.experiments.records import TrialRecord
from dexnudge.experiments.statistics import Estimate, mean_estimate, mean_of_known
from dexnudge.experiments.tables import group_table
from dexnudge.experiments.trial import Section, TrialKind
from dexnudge.experiments.trial_sampler import Drawn, TrialSampler
from dexnudge.hands.hand import Hand
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.planning.outcomes import Outcome
from dexnudge.simulation.model import SimulationModel, changed_physics, scene_model
from dexnudge.synthesis.acceptance import PRESSING

MARGIN_EDGES = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0)  # of the bins of force margins
CAPPED = "3 (cap)"  # the bin of those that are capped


@dataclass(frozen=True)
class ExecutedDraw:
    """One executed configuration.

    Attributes:
        rank: place among the verified draws, 0 the best.
        force_margin: at most 3. links: number of hand links in contact. behaviour: push, press or hook.
        outcome: value of an `Outcome`. length_asked, length_reached [m], turned_deg, sunk [m], hand_environment [m]: see
            `simulation.success.PushVerdict`.
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
    cone_share: float
    approach: str
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
    def top_succeeded(self) -> bool:
        """Whether the best verified draw is there and succeeds."""
        return self.top is not None and self.top.success


Records = Sequence[ExecutionRecord]
ByScene = dict[str, dict[str, GroupRate]]


def by_scene(records: Records, outcomes: Callable[[Records], Iterable[tuple[str, str, bool]]]) -> ByScene:
    """Return the rates of groups of outcomes (group, object, success), of "all" scenes and of each."""
    scenes = dict.fromkeys(record.scene for record in records)
    chosen = {"all": list(records), **{name: [each for each in records if each.scene == name] for name in scenes}}
    return {name: group_rates(outcomes(some)) for name, some in chosen.items()}


def grouped(records: Records, name: Callable[[ExecutedDraw], str]) -> ByScene:
    """Return the rates of executed draws, grouped by a name."""
    return by_scene(
        records, lambda some: ((name(each), one.object, each.success) for one in some for each in one.executed)
    )


def disturbed(records: Records) -> ByScene:
    """Return the rates of draws that were also played with errors, by setting; `AS_DRAWN` is the same without one."""
    return by_scene(
        records,
        lambda some: (
            (setting_text(setting), one.object, success)
            for one in some
            for each in one.executed
            if each.disturbed
            for setting, success in {AS_DRAWN: each.success, **each.disturbed}.items()
        ),
    )


def margin_bins() -> list[str]:
    """Return the names of the bins of force margins, ascending."""
    return [f"{low:g} to {high:g}" for low, high in pairwise(MARGIN_EDGES)] + [CAPPED]


def margin_bin(margin: float) -> str:
    """Return the bin of a verified draw's force margin: its lower edge belongs to it, its upper one to the next."""
    return margin_bins()[int(np.searchsorted(MARGIN_EDGES, margin, side="right")) - 1]


def _single(records: Records) -> Estimate | None:
    found = group_rates(("", one.object, each.success) for one in records for each in one.executed)
    return found[""].rate if found else None


def _outcomes(records: Records) -> dict[str, int]:
    """Executed draws that fail by outcome, and objects of which none could be executed."""
    counts = Counter(each.outcome.replace("_", " ") for one in records for each in one.executed if not each.success)
    for status, name in (("failed", "object failed"), ("unverified", "no draw verified")):
        counts[name] += sum(one.status == status for one in records)
    return {name: count for name, count in counts.most_common() if count}


def _length(value: Callable[[ExecutedDraw], float]) -> Callable[[Records], Estimate | None]:
    return lambda records: mean_of_known(1e3 * value(one.top) for one in records if one.top is not None)


RATES = (
    OBJECTS,
    FAILED,
    UNVERIFIED,
    Metric("top", "top-ranked", lambda records: mean_estimate([float(one.top_succeeded) for one in records])),
    Metric("length_asked_mm", "length asked, mm", _length(lambda each: each.length_asked), 0),
    Metric("length_reached_mm", "reached, mm", _length(lambda each: each.length_reached), 0),
    Metric("executed", "executed", lambda records: sum(len(one.executed) for one in records), 0),
    Metric("single", "of these", _single),
)
OUTCOME = Metric("outcomes", "outcome", _outcomes, 0)
GROUPS: dict[str, Callable[[ExecutedDraw], str]] = {  # title -> group of an execution
    "behaviour": lambda each: each.behaviour,
    "links in contact": lambda each: f"{each.links:2d}",
    "approach": lambda each: "found" if each.approach else "none, starts at contact",
}


@dataclass(frozen=True)
class ExecutionTrial(TrialKind[ExecutionRecord]):
    """Execute the best verified draws.

    Attributes:
        num: of them, best first.
        errors: whether the best one is also played in the physics of `EXECUTED_AT`.
    """

    title: ClassVar[str] = "Executed in physics"
    about: ClassVar[str] = (
        "Top-ranked: share of all attempted objects whose best verified draw, the one that a robot would use, succeeds in "
        "physics; an object that failed or has no verified draw counts as one that does not. Length: of the push that is "
        "asked for, and what is reached, mean over top-ranked draws. Executed: the first verified draws of each, and the "
        "share of them that succeeds. In %; in brackets, 95 % intervals by bootstrap over objects."
    )
    folder: ClassVar[str] = "executed"
    record: ClassVar[type[ExecutionRecord]] = ExecutionRecord
    tables: ClassVar[Mapping[str, Sequence[Metric]]] = {"": RATES, "Why executions failed": (OUTCOME,)}
    rate: ClassVar[str] = "top"

    num: int = 1
    errors: bool = False

    def start(self, config: ExperimentConfig) -> Callable[[TrialKey], ExecutionRecord]:
        """Load the sampler; return what draws and executes for a trial."""
        sampler = TrialSampler(config)

        def run(key: TrialKey) -> ExecutionRecord:
            clock = time.perf_counter()
            drawn = sampler.draw(key)
            drawing = time.perf_counter() - clock
            executed = self._execute(sampler.hand, drawn)
            return ExecutionRecord(
                **key._asdict(),
                status="done" if executed else "unverified",
                seed=trial_seed(config.seed, key),
                num=len(drawn.samples.q),
                verified=drawn.samples.num_verified,
                executed=executed,
                seconds={"draw": round(drawing, 4), "execute": round(time.perf_counter() - clock - drawing, 4)},
            )

        return run

    def succeeded(self, record: ExecutionRecord) -> bool:
        """Whether the top-ranked draw succeeds."""
        return record.top_succeeded

    def sections(self, records: Records) -> list[Section]:
        """Return rates by force margin, behaviour, contacts and approach, and with errors where there are some."""
        bins, changed = grouped(records, lambda each: margin_bin(each.force_margin)), disturbed(records)
        series = bins if len(bins) > 2 else {"all": bins["all"]}
        found = [
            Section(
                "By force margin",
                "Force margin: the largest factor, at most 3, on the surroundings' friction at which the forces balance.",
                group_table("force margin", bins),
                ("calibration.png", lambda: calibration_chart("Executed, by force margin", margin_bins(), series)),
                numbers=bins,
            )
        ]
        for title, name in GROUPS.items():
            groups = grouped(records, name)
            found.append(Section(f"By {title}", "", group_table(title, groups), numbers=groups))
        if changed["all"]:
            text = (
                "The top-ranked draws once more, with one quantity of the physics multiplied, while approach and forces "
                "were planned for its nominal value; n is how many were played so."
            )
            found.append(
                Section("With friction and mass errors", text, group_table("setting", changed), numbers=changed)
            )
        return found

    def _execute(self, hand: Hand, drawn: Drawn) -> list[ExecutedDraw]:
        chosen = np.flatnonzero(drawn.samples.success)[: self.num].tolist()
        if not chosen:
            return []
        simulation = scene_model(hand, drawn.scene)
        executor = Executor(drawn.scene, simulation)
        return [self._executed(rank, executor, drawn, index, simulation) for rank, index in enumerate(chosen)]

    def _executed(
        self, rank: int, executor: Executor, drawn: Drawn, index: int, simulation: SimulationModel
    ) -> ExecutedDraw:
        sample = drawn.samples[index]
        q = sample.q.astype(np.float64)
        execution = executor(q)
        verdict, root = execution.verdict, q[:3] - drawn.scene.object_in_world().center_mass
        changed = [(name, factor) for name, factors in EXECUTED_AT.items() for factor in factors]
        return ExecutedDraw(
            rank=rank,
            force_margin=round(sample.force_margin, 4),
            links=len(sample.contact_links),
            behaviour=behaviour_in_scene(sample.contacts, drawn.scene.motion, root),
            outcome=verdict.outcome.value,
            length_asked=round(verdict.length_asked, 5),
            length_reached=round(verdict.length_reached, 5),
            turned_deg=round(verdict.turned_deg, 3),
            sunk=round(verdict.sunk, 5),
            hand_environment=round(verdict.hand_environment, 6),
            cone_share=float(execution.forces.cone_share[0]),
            approach="" if execution.approach.trajectory is None else execution.approach.planner,
            disturbed={
                setting_name(name, factor): executor.again(
                    q, execution, changed_physics(simulation, **{name: factor})
                ).success
                for name, factor in (changed if self.errors and rank == 0 else [])
            },
        )


def behaviour_in_scene(contacts: HandContacts, motion: Float[np.ndarray, "3"], root: Float[np.ndarray, "3"]) -> str:
    """Return press, hook or push, by the rule of the dataset (`synthesis.acceptance.behaviour_of`) for one motion.

    press: the contacts' mean outward normal points up. Otherwise hook if the hand's root lies ahead of the object (it
    pulls), else push. root: from the object's middle [m, world].
    """
    if contacts.normals[:, 2].mean() > PRESSING:
        return "press"
    return "hook" if float(root @ motion) > 0 else "push"
