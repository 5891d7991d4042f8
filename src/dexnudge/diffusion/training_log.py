"""What a training run reports: one JSON line per event, and TensorBoard where it is installed."""

import importlib.util
import json
from pathlib import Path

LOG_NAME = "train.jsonl"


class TrainingLog:
    """Appends to `train.jsonl` and to `tensorboard/`, until `close`.

    Lines from steps after `step`, written before a crash and about to be repeated, are dropped.
    """

    def __init__(self, folder: Path, *, step: int) -> None:
        path = folder / LOG_NAME
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True) if path.is_file() else []
        kept = [line for line in lines if line.endswith("\n") and json.loads(line)["step"] <= step]
        self._file = path.open("w", encoding="utf-8")
        self._file.writelines(kept)
        self._writer = None
        if importlib.util.find_spec("tensorboard") is not None:
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(str(folder / "tensorboard"), purge_step=step + 1)

    def write(self, step: int, values: dict[str, float]) -> None:
        """One event; the file is flushed so that it can be followed."""
        self._file.write(json.dumps({"step": step, **{name: round(value, 6) for name, value in values.items()}}) + "\n")
        self._file.flush()
        if self._writer is not None:
            for name, value in values.items():
                self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Flush and close both."""
        self._file.close()
        if self._writer is not None:
            self._writer.close()
