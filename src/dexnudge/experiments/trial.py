"""A kind of trial: how one trial runs, what its record holds, and what is reported of many."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic

from dexnudge.experiments.config import ExperimentConfig, TrialKey, trial_seed
from dexnudge.experiments.metrics import Metric
from dexnudge.experiments.records import Record
from dexnudge.experiments.tables import Table


@dataclass(frozen=True)
class Section:
    """A part of a report: a heading, a text, a table, and a chart (file name, function that draws it).

    numbers: what report.json holds under the heading.
    """

    title: str
    text: str = ""
    table: Table | None = None
    chart: tuple[str, Callable[[], Any]] | None = None
    numbers: Any = None


class TrialKind(ABC, Generic[Record]):
    """A kind of trial is a frozen dataclass that derives from this class, in one file.

    Its fields are the options that decide its records beside the experiment's configuration.

    Attributes:
        title: of its report. about: text below the title.
        folder: of its records in the folder of the experiment; "" for that folder itself.
        record: dataclass of its records.
        needs_verified: whether a trial has nothing to do without a verified draw.
        metrics: of its report. rate: name of the one that the bar chart shows.
    """

    title: ClassVar[str]
    about: ClassVar[str]
    folder: ClassVar[str]
    record: ClassVar[type[Any]]
    needs_verified: ClassVar[bool] = True
    metrics: ClassVar[Sequence[Metric]]
    rate: ClassVar[str]

    @abstractmethod
    def start(self, config: ExperimentConfig) -> Callable[[TrialKey], Record]:
        """Load in a process what all of its trials need; return the function that runs one of them.

        A `DexnudgeError` of that function makes the trial a failed one.
        """

    def sections(self, records: Sequence[Record]) -> list[Section]:  # noqa: ARG002  most kinds have none
        """Return what the report says beside the tables of metrics."""
        return []

    def record_without_trial(
        self, config: ExperimentConfig, key: TrialKey, status: str, reason: str = "", *, num: int | None = None
    ) -> Record:
        """Return the record of a trial that failed, or that has no verified draw; its draws stay in the denominators."""
        return self.record(
            **key._asdict(),
            status=status,
            reason=reason,
            num=config.num if num is None else num,
            seed=trial_seed(config.seed, key),
        )
