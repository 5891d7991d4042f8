"""A kind of trial without physics, in one file: all that `TrialRunner` and reports need to know of a new one.

As a script, `toy_trial.py OUT PASSING` runs an experiment whose trials stand still once PASSING of them are recorded.
"""

import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from dexnudge.errors import SceneError
from dexnudge.experiments.config import ExperimentConfig, TrialKey, trial_seed
from dexnudge.experiments.metrics import FAILED, OBJECTS, UNVERIFIED, Metric, share
from dexnudge.experiments.records import FILE, TrialRecord
from dexnudge.experiments.run import TrialRunner
from dexnudge.experiments.trial import TrialKind


@dataclass(frozen=True, kw_only=True)
class ToyRecord(TrialRecord):
    """Verified where the object's name is short; and the process that counted its letters."""

    kind: ClassVar[str] = "toy"

    process: int = 0


@dataclass(frozen=True)
class ToyTrial(TrialKind[ToyRecord]):
    """Count the letters of an object's name; at most `most` are fine.

    refuses, kills: objects that cannot be placed, and that end the process.
    """

    title: ClassVar[str] = "Names counted"
    about: ClassVar[str] = "Short: share of all objects."
    folder: ClassVar[str] = "toy"
    record: ClassVar[type[ToyRecord]] = ToyRecord
    metrics: ClassVar[Sequence[Metric]] = (
        OBJECTS,
        FAILED,
        UNVERIFIED,
        Metric("short", share(lambda each: each.succeeded), "short"),
    )
    rate: ClassVar[str] = "short"

    most: int = 8
    refuses: str = ""
    kills: str = ""

    def start(self, config: ExperimentConfig) -> Callable[[TrialKey], ToyRecord]:
        """Return what counts."""

        def run(key: TrialKey) -> ToyRecord:
            if key.object == self.kills:
                os._exit(9)
            if key.object == self.refuses:
                raise SceneError("it does not fit")
            stand_still()
            seed = trial_seed(config.seed, key)
            short = len(key.object) <= self.most
            return ToyRecord(**key._asdict(), num=config.num, verified=int(short), seed=seed, process=os.getpid())

        return run


def stand_still() -> None:
    """Wait for ever once as many trials are recorded as DEXNUDGE_TOY_PASSING says, in the file DEXNUDGE_TOY_RECORDS."""
    if "DEXNUDGE_TOY_RECORDS" in os.environ:
        records, passing = Path(os.environ["DEXNUDGE_TOY_RECORDS"]), int(os.environ["DEXNUDGE_TOY_PASSING"])
        while records.exists() and records.read_bytes().count(b"\n") >= passing:
            time.sleep(1.0)  # until this process is killed


if __name__ == "__main__":
    out = Path(sys.argv[1])
    os.environ["DEXNUDGE_TOY_RECORDS"], os.environ["DEXNUDGE_TOY_PASSING"] = str(out / "toy" / FILE), sys.argv[2]
    list(TrialRunner([ToyTrial()], ExperimentConfig(objects="builtin:test", scenes=("table", "shelf")), out).run())
