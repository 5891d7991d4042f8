"""Entry point: reads the arguments, runs one subcommand, turns its outcome into an exit code."""

import signal
import sys
from collections.abc import Sequence
from typing import Annotated

import tyro

from dexnudge.cli.check import Check
from dexnudge.cli.dataset import Dataset
from dexnudge.cli.evaluate import Evaluate
from dexnudge.cli.execute import Execute
from dexnudge.cli.hand import HandCommand
from dexnudge.cli.reproduce import Reproduce
from dexnudge.cli.sample import Sample
from dexnudge.cli.train import Train
from dexnudge.errors import DexnudgeError

DONE = 0
BAD_INPUT = 2  # also what argument errors exit with
INTERRUPTED = 130  # 128 + SIGINT, as shells report it
TERMINATED = 143  # 128 + SIGTERM

DESCRIPTION = "Hand configurations that push, press or hook thin objects that a robot hand cannot grasp."

Command = (
    Annotated[Sample, tyro.conf.subcommand("sample")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Execute, tyro.conf.subcommand("execute")]
    | Annotated[Dataset, tyro.conf.subcommand("dataset")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[HandCommand, tyro.conf.subcommand("hand")]
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run `dexnudge` with these arguments, or the process's own, and return the exit code.

    0 done, 2 bad input (one message on stderr), 130 interrupted. Any other exception is a bug and passes through.

    Raises:
        SystemExit: 2 on arguments that do not parse, 0 after --help.
    """
    command = tyro.cli(
        Command,
        args=argv,
        prog="dexnudge",
        description=DESCRIPTION,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes),
    )
    try:
        return command.run()
    except DexnudgeError as error:
        print(f"dexnudge: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("dexnudge: interrupted", file=sys.stderr)
        return INTERRUPTED


def run() -> None:
    """Console script: `main` with the process's arguments, clean-up on SIGTERM as on Ctrl-C."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    sys.exit(main())


if __name__ == "__main__":
    run()
