"""Running the command line in this process, as a user would see it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

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


SAMPLED_NUM = 8


@pytest.fixture(scope="session")
def sampled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result folder of eight draws for a phone on a table, with the shipped model; not to be changed."""
    folder = tmp_path_factory.mktemp("sampled") / "phone"
    options = ["--scene", "table", "--num", str(SAMPLED_NUM), "--seed", "0", "--out", str(folder)]
    assert main(["sample", "phone", *options]) == 0
    return folder
