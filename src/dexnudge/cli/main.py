"""Entry point: reads the arguments, runs one subcommand, turns its outcome into an exit code."""

import importlib
import re
import signal
import sys
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

from dexnudge import __version__
from dexnudge.errors import DexnudgeError, did_you_mean

DONE = 0
BAD_INPUT = 2  # also what argument errors exit with
INTERRUPTED = 130  # 128 + SIGINT, as shells report it
TERMINATED = 143  # 128 + SIGTERM

# Module and class of each command, imported when it is called, and what it does.
COMMANDS = {
    "sample": ("sample", "Sample", "verified, ranked hand configurations for one object in one scene"),
    "check": ("check", "Check", "recompute every figure of a result folder from its files"),
    "execute": ("execute", "Execute", "play configurations out in MuJoCo: push, or slide, grasp and lift"),
    "evaluate": ("evaluate", "Evaluate", "success over many objects and scenes, with intervals"),
    "reproduce": ("reproduce", "Reproduce", "the paper's tables and our ablations, as one report"),
    "dataset": ("dataset", "Dataset", "generate, count and check configurations to learn from"),
    "train": ("train", "Train", "train the diffusion model on a dataset"),
    "hand": ("hand", "HandCommand", "show what a hand consists of, and export it"),
}
USAGE = f"usage: dexnudge [-h] [--version] {{{','.join(COMMANDS)}}} ...\n"
HELP = f"""\
{USAGE}
Hand configurations that push, press or hook thin objects that a robot hand cannot grasp.

commands:
""" + "".join(f"  {name:<11}{what}\n" for name, (_, _, what) in COMMANDS.items())
ARGUMENT = re.compile(r"`(\w+)`")


def main(argv: Sequence[str] | None = None) -> int:
    """Run `dexnudge` with these arguments, or the process's own, and return the exit code.

    0 done, 2 bad input (one message on stderr), 3 done and written but nothing succeeded, 130 interrupted. Any other
    exception is a bug and passes through.

    Raises:
        SystemExit: 2 on arguments that do not parse, 0 after the --help of a command.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments and arguments[0] in ("-h", "--help"):
        print(HELP, end="")
        return DONE
    if arguments and arguments[0] == "--version":
        print(f"dexnudge {__version__}")
        return DONE
    if not arguments or arguments[0] not in COMMANDS:
        what = f"unknown command {arguments[0]!r}{did_you_mean(arguments[0], COMMANDS)}" if arguments else "no command"
        print(f"dexnudge: {what}; expected one of {', '.join(COMMANDS)}\n{USAGE}", end="", file=sys.stderr)
        return BAD_INPUT
    name, *options = arguments
    command = parse(name, options)
    try:
        return command.run()
    except DexnudgeError as error:
        print(f"dexnudge: {with_flags(str(error), command)}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("dexnudge: interrupted", file=sys.stderr)
        return INTERRUPTED


def parse(name: str, options: Sequence[str]) -> Any:
    """The command of this name with these options.

    Raises:
        SystemExit: 2 on options that do not parse, 0 after --help.
    """
    import tyro

    module, kind, _ = COMMANDS[name]
    return tyro.cli(
        getattr(importlib.import_module(f"dexnudge.cli.{module}"), kind),
        args=options,
        prog=f"dexnudge {name}",
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes),
    )


def with_flags(message: str, command: Any) -> str:
    """A message of the library, which names arguments as `num_draws`, with the command's options: --num-draws."""
    flags = _flags(command)
    return ARGUMENT.sub(lambda found: flags.get(found[1], found[0]), message)


def _flags(options: Any) -> dict[str, str]:
    """How the arguments that are options of a command are typed, by name."""
    flags: dict[str, str] = {}
    for field in fields(options):
        value = getattr(options, field.name)
        flags |= _flags(value) if is_dataclass(value) else {field.name: f"--{field.name.replace('_', '-')}"}
    return flags


def run() -> None:
    """Console script: `main` with the process's arguments, clean-up on SIGTERM as on Ctrl-C."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    sys.exit(main())


if __name__ == "__main__":
    run()
