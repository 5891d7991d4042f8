"""What the command says about itself, and how fast."""

import re
import subprocess
import sys
import time

import pytest

COMMANDS = [
    "sample",
    "check",
    "evaluate",
    "reproduce",
    "execute",
    "dataset",
    "dataset generate",
    "dataset info",
    "dataset check",
    "train",
    "hand",
]


def test_top_level_help_lists_the_commands(dexnudge):
    outcome = dexnudge("--help")
    assert outcome.code == 0
    assert "Hand configurations that push, press or hook thin objects" in outcome.out
    for command in {name.split()[0] for name in COMMANDS}:
        assert re.search(rf"^  {command} +[a-z]", outcome.out, re.MULTILINE)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_without_tracebacks_or_undocumented_options(dexnudge, command):
    outcome = dexnudge(*command.split(), "--help")
    assert outcome.code == 0
    assert outcome.out.startswith(f"usage: dexnudge {command} ")
    assert outcome.err == ""


def test_defaults_in_the_help_are_those_of_the_scene(dexnudge):
    from dexnudge.scenes.scene import FRICTION_ENVIRONMENT, FRICTION_HAND, MASS, MAX_NORMAL_FORCE

    text = " ".join(dexnudge("sample", "--help").out.replace("│", " ").split())
    assert f"Mass of the object [kg]; {MASS:g} unless given." in text
    assert f"Coulomb coefficient between hand and object; {FRICTION_HAND:g} unless given." in text
    assert f"Coulomb coefficient between object and surroundings; {FRICTION_ENVIRONMENT:g} unless given." in text
    assert f"Largest normal force of one finger link [N]; {MAX_NORMAL_FORCE:g} unless given." in text


@pytest.mark.parametrize("arguments", [["--help"], ["sample", "--help"]])
def test_help_takes_less_than_a_second(arguments):
    def seconds() -> float:
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "dexnudge", *arguments], check=True, capture_output=True, timeout=30)
        return time.perf_counter() - start

    assert min(seconds() for _ in range(3)) < 1.0  # the best of three: other tests share the cores


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from dexnudge.cli.main import main\n"
        "try: main(['sample', '--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'torch', 'numpy', 'trimesh', 'mujoco', 'warp', 'scipy', 'pyarrow'} & set(sys.modules)\n"
        "print(sorted(heavy), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=30)
    assert done.stderr.strip() == "[]"


@pytest.mark.parametrize(
    "arguments",
    [[], ["smaple"], ["sample"], ["sample", "phone"], ["sample", "phone", "--out", "x", "--num", "many"], ["dataset"]],
)
def test_arguments_that_do_not_parse_exit_2_and_explain(dexnudge, arguments):
    outcome = dexnudge(*arguments)
    assert outcome.code == 2
    assert outcome.err.strip()
    assert "Traceback" not in outcome.err
