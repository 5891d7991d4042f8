"""Entry point: reads the arguments, runs one subcommand, turns its outcome into an exit code."""

import errno
import itertools
import os
import re
import shlex
import signal
import socket
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from importlib import import_module
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from typing import Any

from dexnudge.cli.streams import open_streams, send_nowhere
from dexnudge.errors import (
    LONGEST_PART,
    LONGEST_PATH,
    DexnudgeError,
    InputError,
    OutputError,
    UnknownNameError,
    check_path,
    did_you_mean,
    printable,
    printable_name,
    quote,
    shortened,
)
from dexnudge.version import __version__

DONE = 0
BAD_INPUT = 2  # also what argument errors exit with
INTERRUPTED = 130  # 128 + SIGINT, as shells report it
PIPE_ENDED = 141  # 128 + SIGPIPE
TERMINATED = 143  # 128 + SIGTERM
LEAST_ADDRESS_SPACE = 2_100_000_000  # bytes; 32 draws for a phone on a table took 2.09 GB, 0.76 GB of it resident

# Module and class of each command, imported when it is called, and what it does.
COMMANDS = {
    "sample": ("sample", "Sample", "verified, ranked hand configurations for one object in one scene"),
    "check": ("check", "Check", "recompute every figure of a result folder from its files"),
    "plan": ("plan", "Plan", "from configurations to a trajectory of arm and hand"),
    "execute": ("execute", "Execute", "play configurations out in MuJoCo: push, or slide, grasp and lift"),
    "view": ("view", "View", "the studio: look at results, play executions, change scenes and sample, in the browser"),
    "find-base": ("find_base", "FindBase", "where an arm may stand to reach the configurations of a result folder"),
    "scene": ("scene", "SceneCommand", "what is understood of a scene, and what is wrong with it, before sampling"),
    "evaluate": ("evaluate", "Evaluate", "success over many objects and scenes, with intervals"),
    "benchmark make": ("benchmark", "MakeBenchmark", "the tasks of a benchmark, as folders that any method can read"),
    "benchmark score": ("benchmark", "ScoreBenchmark", "judge entries of a benchmark, and compare them"),
    "reproduce": ("reproduce", "Reproduce", "the paper's tables and our ablations, as one report"),
    "dataset generate": ("dataset", "Generate", "grasps and non-prehensile configurations to learn from"),
    "dataset info": ("dataset", "Info", "what a dataset holds, in tables and as a page"),
    "dataset check": ("dataset", "CheckDataset", "read a dataset again, and verify it from the meshes"),
    "dataset turns": ("dataset", "LabelTurns", "judge which configurations of an older dataset turn their object"),
    "train": ("train", "Train", "train the diffusion model on a dataset"),
    "convert": ("convert", "Convert", "files for and from DexGraspNet, BODex, LeRobot, MuJoCo and USD"),
    "plugins": ("plugins", "Plugins", "list what is built in and what installed packages bring"),
    "hand": ("hand", "HandCommand", "understand, prepare and learn a hand"),
    "arm": ("arm", "ArmCommand", "an arm's joints, limits, reach and flange, and a picture of it with a hand"),
}
RESUMABLE = ("evaluate", "reproduce", "benchmark score", "dataset generate", "dataset turns", "train")
WHAT = "Hand configurations that push, press or hook thin objects that a robot hand cannot grasp."
VECTORS = {"--motion": "DX DY DZ", "--about": "X Y Z"}
UNCERTAIN = "--uncertain"
HOME = re.compile(r"((?:--)?[\w-]+=)?(~[\w.-]*(?:/.*)?)", re.ASCII | re.DOTALL)  # --out=~/x and NAME=~/x, too
SHORTER = f"expected each name of at most {LONGEST_PART} bytes and all of at most {LONGEST_PATH}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run `dexnudge` with these arguments, or the process's own, and return the exit code.

    0 done, 2 bad input or too little memory (one message on stderr), 3 done and written but nothing succeeded, 130
    interrupted. Any other exception is a bug and passes through.

    Raises:
        SystemExit: 2 on arguments that do not parse, 0 after the --help of a command.
    """
    arguments = _at_home(sys.argv[1:] if argv is None else argv)
    kind = None
    try:
        if arguments[:1] == ["--version"]:
            print(f"dexnudge {__version__}")
            return DONE
        if help_text := _help(arguments):
            print(help_text, end="")
            return DONE
        name = find_command(arguments)
        _check_address_space()
        _check_working_directory()
        kind = command_class(name)
        return parse(name, kind, arguments[len(name.split()) :]).run()
    except DexnudgeError as error:
        message = str(error)
        if kind:
            from dexnudge.cli.arguments import with_flags

            message = with_flags(message, kind)
        for name in {part for argument in arguments for part in Path(argument).parts if "\n" in part}:
            message = message.replace(name, printable_name(name))
        print(f"dexnudge: {shortened(printable(message))}", file=sys.stderr)
        return BAD_INPUT
    except (MemoryError, RuntimeError, OSError) as error:
        from dexnudge.geometry.devices import ran_out_of_memory

        if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
            print(f"dexnudge: {quote(error.filename)} is no path of this file system; {SHORTER}", file=sys.stderr)
            return BAD_INPUT
        if not ran_out_of_memory(error):
            raise
        said = shortened(printable(str(error).split("\n")[0])) or "no more was given"
        print(f"dexnudge: ran out of memory ({said}); free some, raise its limit, or ask for less", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(_interrupted(arguments), file=sys.stderr)
        return INTERRUPTED


def _at_home(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with the home folder in place of a leading ~, which shells leave in quotes and after =."""
    found = ((word, HOME.fullmatch(word)) for word in arguments)
    expanded = os.path.expanduser  # leaves a user that there is not as it is
    return [(home[1] or "") + expanded(home[2]) if home else word for word, home in found]


def _check_working_directory() -> None:
    """Refuse a working directory that was deleted: without one libraries end the process as they are loaded; InputError."""
    try:
        Path.cwd()
    except OSError as error:
        raise InputError(
            f"the working directory cannot be found ({error.strerror}); expected one that exists; change to another by `cd`"
        ) from error


def _check_address_space() -> None:
    """Refuse a limit under which libraries cannot even be loaded: they would end in tracebacks of many kinds; InputError."""
    if find_spec("resource") is None:  # Windows
        return
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if 0 <= limit < LEAST_ADDRESS_SPACE:
        raise InputError(
            f"the address space of this process is limited to {limit / 1e9:.2f} GB; expected at least "
            f"{LEAST_ADDRESS_SPACE / 1e9:.1f} GB; raise the limit with `ulimit -v unlimited`"
        )


def _interrupted(arguments: list[str]) -> str:
    """Return what to type after an interruption."""
    resumable = any(arguments[: len(name.split())] == name.split() for name in RESUMABLE)
    resumable |= arguments[:1] == ["hand"] and "--learn" in arguments
    begun = all(os.path.isdir(out) for out in _values(arguments, "--out"))  # noqa: PTH112 - no name is too long
    going_on = (
        "goes on from where it stopped" if resumable and begun else "starts again; what stood before is as it was"
    )
    return f"dexnudge: interrupted; `{shlex.join(['dexnudge', *arguments])}` {going_on}"


def _values(arguments: Sequence[str], flag: str) -> list[str]:
    """Return what an option is given, `--out NAME` or `--out=NAME`."""
    after = [value for option, value in itertools.pairwise(arguments) if option == flag]
    return after + [option.partition("=")[2] for option in arguments if option.startswith(f"{flag}=")]


def _help(arguments: Sequence[str]) -> str:
    """Return the help that lists commands, where it is asked for: that of `dexnudge`, or of `dexnudge dataset`."""
    if not arguments or arguments[-1] not in ("-h", "--help"):
        return ""
    names = [name for name in COMMANDS if name.split()[: len(arguments) - 1] == list(arguments[:-1])]
    if not names or names == [" ".join(arguments[:-1])]:
        return ""
    listed = "".join(f"  {name:<18}{COMMANDS[name][2]}\n" for name in names)
    return (
        f"usage: {' '.join(['dexnudge', *arguments[:-1]])} [-h] [--version] COMMAND ...\n\n{WHAT}\n\ncommands:\n{listed}\n"
        "dexnudge COMMAND --help tells the options of a command.\n"
    )


def find_command(arguments: Sequence[str]) -> str:
    """Return the name of the command that the arguments begin with.

    Raises:
        UnknownNameError: no such command, or none.
    """
    for name in COMMANDS:
        if list(arguments[: len(name.split())]) == name.split():
            return name
    actions = [known for known in COMMANDS if arguments and known.startswith(f"{arguments[0]} ")]
    given, known = " ".join(arguments[: 2 if actions else 1]), actions or list(COMMANDS)
    what = f"unknown command {given!r}{did_you_mean(given, known)}" if given else "no command"
    raise UnknownNameError(f"{what}; expected one of {', '.join(known)}; dexnudge --help tells what they do")


def command_class(name: str) -> Any:
    """Return the dataclass of a command, whose fields are its options."""
    module, kind, _ = COMMANDS[name]
    return getattr(import_module(f"dexnudge.cli.{module}"), kind)


def parse(name: str, kind: Any, options: Sequence[str]) -> Any:
    """Return the command with its options.

    Raises:
        InputError: a vector without its three numbers, --uncertain without a word, or values that a configuration of the
            library refuses.
        SystemExit: 2 on other options that do not parse, 0 after --help.
    """
    import tyro

    config = (tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff)
    _check_values(options)
    try:
        with redirect_stderr(StringIO()) as said:
            return tyro.cli(kind, args=options, prog=f"dexnudge {name}", config=config)
    except SystemExit as exit_:
        refused: BaseException | None = exit_
        while refused and not isinstance(refused, DexnudgeError):
            refused = refused.__context__
        if refused:
            raise refused from None
        sys.stderr.write(said.getvalue())
        sys.stdout.flush()  # the help
        raise


def _check_values(options: Sequence[str]) -> None:
    from dexnudge.cli.arguments import is_number

    for place, option in enumerate(options):
        flag, _, value = option.partition("=")
        before = options[place - 1] if place else ""
        named = flag if flag.startswith("--") else before if before.startswith("--") else "an argument"
        word = value if flag.startswith("--") else option
        if not is_number(word) and named != "--host":
            check_path(named, word)  # what is no number may become one
        if option == UNCERTAIN and (place + 1 == len(options) or options[place + 1].startswith("--")):
            from dexnudge.scenes.uncertainty import EXPECTED

            raise InputError(f"{UNCERTAIN} got nothing; {EXPECTED}")
        if flag in VECTORS:
            given = [value] if value else list(options[place + 1 : place + 4])
            if len(given) < 3 or not all(map(is_number, given)):
                got = " ".join(itertools.takewhile(lambda text: not text.startswith("--"), given)) or "nothing"
                raise InputError(f"{flag} got {got}; expected three numbers: {flag} {VECTORS[flag]}")


GRACE = 2.5  # [s] from the signal on; longer than any of a job's own steps that save something


@contextmanager
def ended_after_signal(message: str, *, seconds: float = GRACE) -> Iterator[None]:
    """End this process `seconds` after SIGINT or SIGTERM, wherever it is then, unless the block ends before.

    Python answers a signal between two of its own steps, and one call of a library may take minutes. Such an end costs no
    more than a kill, which every job survives: the item that it was at. Exit code 128 + signal, with `message` on stderr.
    Only the main thread may call it.
    """
    told, tell = socket.socketpair()
    tell.setblocking(False)
    over = threading.Event()
    before = signal.set_wakeup_fd(tell.fileno(), warn_on_full_buffer=False)

    def watch() -> None:
        while number := told.recv(1):
            if number[0] in (signal.SIGINT, signal.SIGTERM) and not over.wait(seconds):
                print(message, file=sys.stderr, flush=True)
                os._exit(128 + number[0])

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    try:
        yield
    finally:
        over.set()
        signal.set_wakeup_fd(before)
        tell.shutdown(socket.SHUT_RDWR)  # a forked process may have it open, too
        watching.join()
        tell.close()
        told.close()


def run() -> None:
    """Console script: `main` with the process's arguments, clean-up on SIGTERM as on Ctrl-C, and an end soon after either.

    What numpy warns of on the way, as of an overflow by a coordinate of 1e300, ends in a message of ours.
    """
    open_streams()
    warnings.simplefilter("ignore", RuntimeWarning)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    message = _interrupted(_at_home(sys.argv[1:]))
    with ended_after_signal(message):
        try:
            code = main()
            sys.stdout.flush()
        except SystemExit as ended:
            if ended.code == TERMINATED:
                print(message, file=sys.stderr)
            raise
        except BrokenPipeError:  # whoever read the output has seen enough, such as `head`
            send_nowhere(sys.stdout.fileno())
            code = PIPE_ENDED
        except OutputError as error:
            print(f"dexnudge: {error}", file=sys.stderr)
            code = BAD_INPUT
        finally:  # another signal, while Python ends, has nothing to unwind
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, signal.SIG_DFL)
    sys.exit(code)


if __name__ == "__main__":
    run()
