"""Run the trials of an experiment that are not recorded yet, in several processes."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

from dexnudge.errors import DexnudgeError
from dexnudge.experiments.config import ExperimentConfig, TrialKey, trial_keys
from dexnudge.experiments.records import Record, RecordWriter, TrialRecord, read_records
from dexnudge.experiments.statistics import as_json
from dexnudge.experiments.trial import TrialKind
from dexnudge.jobs.atomic_files import remove_leftovers
from dexnudge.jobs.claims import claim_folder, read_claim
from dexnudge.jobs.engines import Engine, run_tasks_by
from dexnudge.jobs.folders import owned_folder
from dexnudge.jobs.processes import WorkerDied

FILE = "experiment.json"
FORMAT_VERSION = 3  # of the file and of the records beside it

OnRecord = Callable[[TrialKind[Any], Sequence[Any], int], None]
"""Of kind, all its records so far, the new one last, and how many there will be."""


@dataclass(frozen=True)
class TrialRunner:
    """Runs the trials of an experiment, one kind after another; resumes where an earlier run was stopped.

    Attributes:
        kinds: of trial, with their options; records of each lie in its own folder.
        config: of the experiment.
        out: its folder; need not hold anything yet. One that holds another experiment is refused.
    """

    kinds: Sequence[TrialKind[Any]]
    config: ExperimentConfig
    out: Path

    def run(
        self,
        *,
        workers: int = 2,
        engine: Engine = "processes",
        ray_address: str | None = None,
        on_record: OnRecord | None = None,
    ) -> Iterator[tuple[TrialKind[Any], list[Any]]]:
        """Run what is not recorded yet; yield each kind when it is finished, with all records in the order of `trial_keys`.

        Draws are made anew with the seed of the experiment, which gives the draws of its own records. Where such a record
        is there and has no verified draw, a kind that needs one has nothing to run. The records are the same whatever the
        engine, see `run_tasks_by`; on a Ray cluster they are written here, and files that the config names have to be on
        folders that all machines share.

        Raises:
            InputError: the folder holds another experiment, or one with other options; a name or count is not valid.
            OutputError: the folder cannot be written, or another run works on it.
        """
        keys = trial_keys(self.config)
        with owned_folder(self.out):
            for kind in self.kinds:
                together = attrgetter("object", "scene")  # trials that share what has to be prepared for them
                run = partial(run_tasks_by, engine, workers=workers, ray_address=ray_address, together=together)
                yield kind, self._run(kind, keys, run, on_record)

    def _run(
        self, kind: TrialKind[Record], keys: Sequence[TrialKey], run: Callable[..., Any], on_record: OnRecord | None
    ) -> list[Record]:
        config, folder = self.config, self.out / kind.folder
        claim = {
            **asdict(config),
            **{f"{kind.record.kind}_{name}": as_json(value) for name, value in vars(kind).items()},
        }
        claim_folder(folder, FILE, claim, format_version=FORMAT_VERSION, device=config.device)
        remove_leftovers(folder)
        records = {record.key: record for record in read_records(folder, kind.record)}
        drawn = {record.key: record for record in read_records(self.out, TrialRecord)} if kind.needs_verified else {}
        with closing(RecordWriter(folder)) as writer:

            def add(record: Record) -> None:
                writer.append(record)
                records[record.key] = record
                if on_record:
                    on_record(kind, list(records.values()), len(keys))

            for key in [key for key in keys if key in drawn and key not in records]:
                if not (known := drawn[key]).verified:
                    status = "failed" if known.status == "failed" else "unverified"
                    add(kind.record_without_trial(config, key, status, known.reason, num=known.num))
            waiting = [key for key in keys if key not in records]
            if not waiting:
                return [records[key] for key in keys]  # nothing is loaded for nothing
            with closing(run(partial(_start, kind, config), waiting)) as results:
                for key, result in results:
                    if isinstance(result, WorkerDied):
                        add(kind.record_without_trial(config, key, "failed", result.reason))
                    else:
                        add(result)
        return [records[key] for key in keys]


def read_run(kind: TrialKind[Record], out: Path) -> tuple[dict[str, Any], list[Record]]:
    """Return what a run wrote about itself (format_version, config, versions, machine), and its records so far.

    Raises:
        InputError: a file is missing, damaged or of another format.
    """
    folder = out / kind.folder
    return read_claim(folder, FILE, format_version=FORMAT_VERSION), read_records(folder, kind.record)


def _start(kind: TrialKind[Record], config: ExperimentConfig) -> Callable[[TrialKey], Record]:
    """In a worker: the function that runs a trial, and makes what cannot be read, placed or run a failed one."""
    run_trial = kind.start(config)

    def run(key: TrialKey) -> Record:
        try:
            return run_trial(key)
        except DexnudgeError as error:
            return kind.record_without_trial(config, key, "failed", f"{type(error).__name__}: {error}")

    return run
