"""What comes back from a task that runs in another process."""

import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dexnudge.errors import DexnudgeError


@dataclass(frozen=True)
class WorkerDied:
    """Stands for the result of a task whose process was killed, for example for want of memory."""

    exit_code: int | None

    @property
    def reason(self) -> str:
        """The same in words."""
        how = "" if self.exit_code is None else f" (exit code {self.exit_code})"
        return f"its worker process died{how}, for example for want of memory"


@dataclass(frozen=True)
class Raised:
    """An error on its way to the process that gave the task, which raises it."""

    error: Exception


def answer(get_handler: Callable[[], Callable[[Any], Any]], task: Any) -> Any:
    """The handler's result, or `Raised`: a deliberate error as it is, any other as a RuntimeError with its traceback."""
    try:
        return get_handler()(task)
    except DexnudgeError as error:
        return Raised(error)
    except Exception:  # noqa: BLE001  a bug: carried to the other side, which raises it
        return Raised(RuntimeError(f"in a worker process, on {task!r}:\n{traceback.format_exc()}"))


def use_one_thread() -> None:
    """One torch thread, since there are as many processes as cores; call it after the handler's module is imported."""
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
