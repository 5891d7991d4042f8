"""What the command says about itself, and how fast."""

import resource
import subprocess
import sys

import pytest

from dexnudge.cli.main import COMMANDS


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


HELP = """
import sys
from dexnudge.cli.main import main
try: main({arguments})
except SystemExit: pass
print(sorted({{"torch", "numpy", "trimesh", "mujoco", "warp", "scipy", "pyarrow"}} & set(sys.modules)), file=sys.stderr)
"""


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_takes_less_than_a_second_of_processor_time_and_imports_nothing_heavy(command):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    code = HELP.format(arguments=[*command.split(), "--help"])
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.stderr.strip() == "[]"
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 1.0


@pytest.mark.parametrize(
    "arguments",
    [[], ["smaple"], ["sample"], ["sample", "phone"], ["sample", "phone", "--out", "x", "--num", "many"], ["dataset"]],
)
def test_arguments_that_do_not_parse_exit_2_and_explain(dexnudge, arguments):
    outcome = dexnudge(*arguments)
    assert outcome.code == 2
    assert outcome.err.strip()
    assert "Traceback" not in outcome.err
