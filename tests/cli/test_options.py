"""What every user of a command line expects: version, suggestions, messages that name options, exit codes."""

import re

import pytest

import dexnudge as package
from dexnudge.cli.arguments import with_flags
from dexnudge.cli.evaluate import Evaluate
from dexnudge.cli.main import COMMANDS, _at_home, parse
from dexnudge.cli.sample import Sample


def test_the_version(dexnudge):
    assert dexnudge("--version").out == f"dexnudge {package.__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["smaple", "phone"], "unknown command 'smaple' (did you mean 'sample'?); expected one of sample, check, "),
        (
            ["dataset", "genrate"],
            "unknown command 'dataset genrate' (did you mean 'dataset generate'?); expected one of dataset ",
        ),
        (["dataset"], "unknown command 'dataset' (did you mean 'dataset info'?); expected one of dataset generate, "),
        ([], "no command; expected one of sample, "),
        (["sample", "phon", "--scene", "table"], "unknown object 'phon' (did you mean 'phone'?); expected a mesh file"),
        (
            ["sample", "phone", "--scene", "tabel"],
            "unknown scene 'tabel' (did you mean 'table'?); expected one of table",
        ),
        (["hand", "shado_lite"], "unknown hand 'shado_lite' (did you mean 'shadow_lite'?): expected one of"),
        (
            ["sample", "phone", "--scene", "table", "--method", "steered"],
            "unknown method 'steered' (did you mean 'steered_noise'?); expected one of",
        ),
    ],
)
def test_a_wrong_name_comes_with_the_nearest_right_one(dexnudge, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    outcome = dexnudge(*arguments)
    assert outcome.code == 2
    assert outcome.err.startswith(f"dexnudge: {message}")
    assert outcome.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_leading_tilde_is_the_home_folder_in_every_path(dexnudge, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "home").mkdir()
    assert dexnudge("scene", "phone", "--scene", "table", "--out", "~/a").code == 0
    assert dexnudge("scene", "~/a", "--out=~/b").code == 0
    assert f"{tmp_path}/home/none" in dexnudge("check", "~/none").err
    assert sorted(path.name for path in (tmp_path / "home").iterdir()) == ["a", "b"]
    assert [path.name for path in tmp_path.iterdir()] == ["home"]


def test_a_tilde_is_expanded_where_a_path_begins_and_nowhere_else(monkeypatch):
    monkeypatch.setenv("HOME", "/h")
    given = ["~", "~/x\n", "--out=~/x", "mine=~/x", "a~", "./~", "~no-such-user/x", "~\0", "--out=a=~/x", "~\udcff"]
    expected = [
        "/h",
        "/h/x\n",
        "--out=/h/x",
        "mine=/h/x",
        "a~",
        "./~",
        "~no-such-user/x",
        "~\0",
        "--out=a=~/x",
        "~\udcff",
    ]
    assert _at_home(given) == expected


def test_an_unknown_option_comes_with_the_nearest_known_one(dexnudge):
    outcome = dexnudge("sample", "phone", "--scnee", "table")
    assert outcome.code == 2
    assert "Unrecognized options: --scnee" in outcome.err
    assert "--scene FAMILY" in outcome.err.partition("Perhaps you meant")[2]


@pytest.mark.parametrize(
    ("given", "got"),
    [
        (["1", "0"], "1 0"),
        (["1", "0", "--num", "3"], "1 0"),
        (["1", "0", "up"], "1 0 up"),
        (["1", "0", "1_0"], "1 0 1_0"),
        ([], "nothing"),
        (["--num", "3", "4"], "nothing"),
    ],
)
def test_a_vector_takes_three_numbers(dexnudge, given, got):
    outcome = dexnudge("sample", "phone", "--environment", "e.obj", "--motion", *given)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err == f"dexnudge: --motion got {got}; expected three numbers: --motion DX DY DZ\n"
    assert dexnudge("scene", "phone", "--scene", "table", "--turn", "9", "--about", *given).err == (
        f"dexnudge: --about got {got}; expected three numbers: --about X Y Z\n"
    )
    assert dexnudge("sample", "phone", "--motion=1,0,0").err == (
        "dexnudge: --motion got 1,0,0; expected three numbers: --motion DX DY DZ\n"
    )


@pytest.mark.parametrize(
    "command", [["sample", "phone", "--scene", "table"], ["evaluate", "--objects", "builtin:test"]]
)
@pytest.mark.parametrize("given", [[], ["--num", "3"]])
def test_uncertain_takes_a_word(dexnudge, command, given):
    outcome = dexnudge(*command, "--uncertain", *given)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err == (
        "dexnudge: --uncertain got nothing; expected KEY=VALUE, such as friction=0.5..1 or pose_mm=2\n"
    )


def test_a_vector_may_stand_before_the_object_and_hold_negative_numbers():
    command = parse("sample", Sample, ["--motion", "-1", "0", "-.5", "phone"])
    assert (command.object, command.motion) == ("phone", (-1.0, 0.0, -0.5))


def test_messages_of_the_library_name_options():
    message = "`max_objects` is 0 with `mass` 1; `start` stays, and so does `dexnudge train --out`"
    assert with_flags(message, Evaluate) == (
        "--max-objects is 0 with --mass 1; `start` stays, and so does `dexnudge train --out`"
    )
    assert with_flags("leave out the forearm (`base`)", Sample) == "leave out the forearm (--no-base)"


@pytest.mark.parametrize(
    ("device", "count", "said"),
    [
        ("gpu", 0, "`device` is 'gpu'; expected cpu, cuda, or one of several as cuda:1"),
        ("cuda:one", 2, "`device` is 'cuda:one'; expected cpu, cuda, or one of several as cuda:1"),
        ("cuda:7", 2, "`device` is 'cuda:7'; expected cpu or what this machine has: cuda:0 to cuda:1"),
        ("cuda:1", 1, "`device` is 'cuda:1'; expected cpu or what this machine has: cuda:0"),
        ("cuda", 0, "`device` is 'cuda', but torch and Warp find no CUDA device here (torch "),
    ],
)
@pytest.mark.parametrize(
    "command", [["sample", "phone", "--scene", "table"], ["evaluate", "--objects", "builtin:test"]]
)
def test_a_device_that_is_not_there(dexnudge, tmp_path, monkeypatch, command, device, count, said):
    monkeypatch.setattr("torch.cuda.is_available", lambda: count > 0)
    monkeypatch.setattr("torch.cuda.device_count", lambda: count)
    monkeypatch.setattr("warp.is_cuda_available", lambda: count > 0)
    outcome = dexnudge(*command, "--device", device, "--out", str(tmp_path / "out"))
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1
    assert said.replace("`device`", "--device") in outcome.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], ["dataset", "--help"]])
def test_the_help_lists_the_commands(dexnudge, arguments):
    outcome = dexnudge(*arguments)
    assert (outcome.code, outcome.err) == (0, "")
    names = [name for name in COMMANDS if arguments[0] != "dataset" or name.startswith("dataset ")]
    assert re.findall(r"^  (\S+(?: \S+)?)  +\S", outcome.out, re.MULTILINE) == names


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            ["--device", "cuda"],
            "--device is 'cuda' with --engine ray, whose workers are given cores alone; expected cpu",
        ),
        (["--ray-address", "127.0.0.1:1"], "no Ray cluster answers at '127.0.0.1:1' ([Errno "),
    ],
)
def test_an_evaluation_on_ray_that_cannot_be(dexnudge, tmp_path, options, said):
    outcome = dexnudge(
        "evaluate", "--objects", "builtin:test", "--out", str(tmp_path / "out"), "--engine", "ray", *options
    )
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.startswith(f"dexnudge: {said}")
    assert outcome.err.count("\n") == 1
