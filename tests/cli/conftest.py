"""Running the command line in this process, as a user would see it."""

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from dexnudge.cli.main import main


@dataclass(frozen=True)
class Outcome:
    """Exit code, and what stood on stdout and stderr."""

    code: int
    out: str
    err: str


Run = Callable[..., Outcome]


@pytest.fixture
def dexnudge(capsys: pytest.CaptureFixture[str]) -> Run:
    """Call `dexnudge(*arguments)`; a traceback (a bug) passes through and fails the test."""

    def run(*arguments: object) -> Outcome:
        capsys.readouterr()
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as exit_:
            code = int(exit_.code or 0)
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    return run
