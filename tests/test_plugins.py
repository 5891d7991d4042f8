"""What installed packages bring: the example package, used by name, and packages that are broken."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dexnudge as dn
from dexnudge.cli.arguments import with_flags
from dexnudge.cli.main import main
from dexnudge.cli.sample import Sample
from dexnudge.plugins import find_plugins, load_plugin, plugin_names, usable_plugins
from dexnudge.verification.criteria import named_criteria

EXAMPLE = Path(__file__).parents[1] / "examples" / "plugin"
RANDOM = "random_start_projection"
FURTHER = "[dexnudge.guidance_rules]\nwild = strange:Explodes\n[dexnudge.energy_terms]\nexplodes = strange:Explodes\n"


@pytest.fixture(scope="session")
def installed(tmp_path_factory):
    """The folder into which the example package is installed, as a user would do it."""
    folder = tmp_path_factory.mktemp("plugin")
    shutil.copytree(EXAMPLE, folder / "source")  # building writes beside the sources
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run(
        [*pip, "--target", folder / "site", folder / "source"], check=True, env={**os.environ, "PYTHONPATH": ""}
    )
    return folder / "site"


@pytest.fixture
def example(installed, monkeypatch):
    monkeypatch.syspath_prepend(installed)


def make_package(folder, name, module, entry_points):
    (folder / f"{name}.py").write_text(module)
    info = folder / f"{name}-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(entry_points)


@pytest.fixture
def broken(tmp_path, monkeypatch):
    """A package that fails at import, and one with criteria that are none; the second also has names that are taken."""
    make_package(tmp_path, "bad_import", "import does_not_exist\n", "[dexnudge.scenes]\nfog = bad_import:fog\n")
    module = (
        "class Other:\n    name = 'other'\n    def __call__(self, hands, scene): ...\n\n"
        "def fails(*_, **__):\n    return 1 / 0\n\n"
        "class Own(Exception): ...\n\n"
        "class Explodes:\n    name, weight = 'explodes', 1.0\n    def __call__(self, *_):\n        raise Own('of its own')\n"
    )
    criteria = {"none": "missing", "misnamed": "Other", "fails": "fails", "explodes": "Explodes", "contact": "Other"}
    points = "[dexnudge.criteria]\n" + "".join(f"{name} = strange:{place}\n" for name, place in criteria.items())
    make_package(tmp_path, "strange", module, points + "[dexnudge.hands]\nclaw = strange:fails\n" + FURTHER)
    monkeypatch.syspath_prepend(tmp_path)


def test_the_example_brings_one_of_each(example):
    assert "ice" in dn.scene_families()
    assert dn.build_scene("ice", "phone", seed=0).friction_environment == 0.05
    criterion, term = dn.find_criterion("palm_height"), load_plugin("energy term", "high_palm")()
    hand, scene = dn.load_hand("shadow_lite"), dn.build_scene("ice", "phone", seed=0)
    found = {}
    for terms in ((), (term,)):
        sampler = dn.Sampler(hand, terms=terms)
        samples = sampler.sample(scene, num=8, seed=0, method=RANDOM, criteria=[*dn.default_criteria(), criterion])
        found[len(terms)] = samples.verdicts.values["palm_height"]
        low = samples.verdicts.values["palm_height"] < 0.06
        assert not samples.success[low].any()
        assert [samples.reasons[row] for row in np.flatnonzero(low)].count("") == 0
    assert found[1].min() > found[0].min()
    arm, panda = dn.load_arm("careful_panda", base=np.eye(4)), dn.load_arm("panda")
    np.testing.assert_allclose(3 * arm.limits.velocity, panda.limits.velocity)


def test_the_example_from_the_command_line(example, tmp_path, capsys):
    out = str(tmp_path / "out")
    options = ["--term", "high_palm=5", "--criterion", "palm_height", "--num", "4", "--method", RANDOM, "--out", out]
    assert main(["sample", "phone", "--scene", "ice", *options]) in (0, 3)
    assert main(["check", out]) == 0
    assert "palm_height" in capsys.readouterr().out
    result = dn.check(out)
    assert result.agrees
    assert not result.not_recomputed
    assert "palm_height" in result.found.values
    assert main(["plugins"]) == 0
    printed = capsys.readouterr().out
    for name in ("ice", "careful_panda", "high_palm", "palm_height", "dexnudge-example 0.1.0"):
        assert name in printed


def test_without_the_package_check_names_the_criterion(installed, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.syspath_prepend(installed)
        hand, scene = dn.load_hand("shadow_lite"), dn.build_scene("table", "phone", seed=0)
        criteria = [*dn.default_criteria(), dn.find_criterion("palm_height")]
        dn.Sampler(hand).sample(scene, num=2, method=RANDOM, criteria=criteria).save(tmp_path / "out")
    result = dn.check(tmp_path / "out")
    assert result.agrees
    assert list(result.not_recomputed) == ["palm_height"]


def test_nothing_of_packages_is_imported_before_it_is_asked_for(broken):
    assert {"none", "misnamed", "fails", "contact"} <= set(plugin_names("criterion"))
    assert "strange" not in sys.modules


def test_a_broken_package_is_named_and_skipped(broken):
    with pytest.warns(
        UserWarning, match=r"skipped: scene 'fog' of package bad_import 1\.2 cannot be imported"
    ) as caught:
        assert "fog" not in dn.scene_families()
    assert len(caught) == 1
    assert dn.build_scene("table", "phone").name == "table"
    with pytest.warns(UserWarning, match=r"criterion 'none' of package strange 1.2"):
        assert set(usable_plugins("criterion")) >= {"misnamed", "fails", "contact"}


def test_what_is_broken_is_listed_with_the_reason(broken):
    found = {p.name: p for p in find_plugins("criterion", builtin=("contact",), find=dn.find_criterion)}
    assert "has no attribute 'missing'" in found["none"].broken
    assert "is named 'other'" in found["misnamed"].broken
    assert found["explodes"].broken == ""
    assert found["contact"].broken == "the name 'contact' is taken by the built-in criterion"
    assert found["misnamed"].source == "strange 1.2"


def test_asking_for_something_broken_keeps_the_cause(broken):
    with pytest.raises(dn.InputError, match=r"scene 'fog' of package bad_import 1\.2 cannot be imported") as caught:
        dn.build_scene("fog", "phone")
    assert isinstance(caught.value.__cause__, ModuleNotFoundError)
    with pytest.raises(dn.InputError, match=r"hand 'claw' of package strange 1\.2 failed: ZeroDivisionError") as caught:
        dn.load_hand("claw")
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    with pytest.raises(dn.InputError, match=r"criterion 'fails' of package strange 1\.2 failed: ZeroDivisionError"):
        dn.find_criterion("fails")
    with pytest.raises(dn.InputError, match=r"criterion 'misnamed' of package strange 1\.2 is named 'other'"):
        dn.find_criterion("misnamed")


def test_a_name_that_nobody_brings(broken):
    with pytest.raises(dn.UnknownNameError, match=r"unknown criterion 'conntact' \(did you mean 'contact'\?\)"):
        dn.find_criterion("conntact")


UNSOUND = """
three, nothing = 3, None
class NeedsMore:
    name, weight = "needs_more", 1.0
    def __init__(self, size): ...
    def __call__(self, *_): ...
class Named(NeedsMore):
    def __init__(self): ...
def family(mesh): ...
def makes_three(): return 3
"""
UNSOUND_POINTS = {  # entry point -> why it is of no use
    "scenes": {
        "three": "is of type int; expected a function that is called with (mesh, generator) and returns a Scene; mend",
        "family": "cannot be called so: too many positional arguments; expected a function",
        "not a ref!!": "is registered as 'not a ref!!'; expected module:name; mend",
    },
    "hands": {
        "family": "cannot be called so",
        "nothing": "is of type NoneType; expected a function that is called with base",
    },
    "arms": {
        "three": "is of type int; expected a function that is called without arguments and returns an Arm; mend",
        "family": "cannot be called so: missing a required argument: 'mesh'",
        "makes_three": "",
    },
    "criteria": {
        "q": "the name of criterion 'q' is taken; expected",
        "not-one": "criterion 'not-one' has no usable name; expected an identifier",
        "NeedsMore": "cannot be called so: missing a required argument: 'size'; expected",
        "makes_three": "made a int; expected a Criterion",
    },
    "energy_terms": {"three": "is of type int", "NeedsMore": "'size'", "makes_three": "term 0 of `terms`, a int"},
    "guidance_rules": {"three": "is of type int", "NeedsMore": "'size'", "makes_three": "made a int; expected a rule"},
}
FLAGS = {"scenes": "--scene", "hands": "--hand", "criteria": "--criterion", "energy_terms": "--term"}


@pytest.fixture
def unsound(tmp_path, monkeypatch):
    lines = []
    for group, entries in UNSOUND_POINTS.items():
        lines.append(f"[dexnudge.{group}]\n")
        for name in entries:
            place = {"q": "Q", "not-one": "NotOne", "not a ref!!": ""}.get(name, name)
            lines.append(f"{name.replace(' ', '_')} = {f'unsound:{place}' if place else name}\n")
    more = "class Q(Named): name = 'q'\nclass NotOne(Named): name = 'not-one'\n"
    make_package(tmp_path, "unsound", UNSOUND + more, "".join(lines))
    monkeypatch.syspath_prepend(tmp_path)


def test_what_is_of_no_use_is_listed_as_broken(unsound, capsys):
    assert main(["plugins"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for entries in UNSOUND_POINTS.values():
        for name, reason in entries.items():
            start = f"  {name.replace(' ', '_')}, from unsound 1.2; broken: "
            shown = start if reason else f"  {name}, from unsound 1.2"
            assert any(line.startswith(shown) and reason in line for line in lines), (name, reason)


@pytest.mark.parametrize(
    ("group", "name"), [(group, name) for group in FLAGS for name in UNSOUND_POINTS[group] if " " not in name]
)
def test_asking_for_what_is_of_no_use_says_whose_it_is(unsound, group, name, capsys):
    scene = [] if group == "scenes" else ["--scene", "table"]
    assert main(["sample", "phone", *scene, FLAGS[group], name, "--out", "unused"]) == 2
    said = capsys.readouterr().err
    assert "of package unsound 1.2" in said
    assert with_flags(UNSOUND_POINTS[group][name], Sample) in said


def test_an_arm_that_is_none_is_refused_by_name(unsound):
    with pytest.raises(dn.InputError, match=r"arm 'makes_three' of package unsound 1.2 made a int; expected a Arm"):
        dn.load_arm("makes_three")


def raises(name):
    return f"    @property\n    def {name}(self): raise KeyError('boom')\n"


CALLED = """    def __call__(self, hands, scene):
        result = dn.CriterionResult(np.ones(len(hands)), np.zeros(len(hands), bool))
        object.__setattr__(result, {!r}, {})  # whatever types it has
        return result
"""
FINE = CALLED.format("sentence", "'no'")
RAISING = """class B:
    def __array__(self, *_, **__): raise KeyError('boom')
    def __str__(self): raise KeyError('boom')
"""
JUDGING = "class f:\n    name = 'evil'\n"
WEIGHING = "class f:\n    name = 'evil'\n" + raises("weight") + "    def __call__(self, *_): ...\n"
METHOD = "from dexnudge.sampling.methods import METHODS\nfrom dataclasses import replace\ndef no(): return {}['boom']\n"
TOUCHES = {  # kind of entry point, source, what is said
    "tolerance": (
        "criteria",
        JUDGING + raises("tolerance") + FINE,
        "criterion 'evil' has no readable `tolerance`: KeyError: 'boom'",
    ),
    "save": ("criteria", JUDGING + raises("save") + FINE, "criterion 'evil' has no readable `save`: KeyError: 'boom'"),
    "value": (
        "criteria",
        RAISING + JUDGING + CALLED.format("value", "B()"),
        "criterion 'evil' returned a value that is no array: KeyError: 'boom'; expected real numbers of shape (1,)",
    ),
    "ragged": (
        "criteria",
        JUDGING + CALLED.format("value", "[[1], [2, 3]]"),
        "criterion 'evil' returned a value that is no array: ValueError: setting an array element with a sequence",
    ),
    "sentence": (
        "criteria",
        RAISING + JUDGING + CALLED.format("sentence", "B()"),
        "criterion 'evil' returned a sentence that is no text: KeyError: 'boom'",
    ),
    "weight": ("energy_terms", WEIGHING, "term 'evil' has no readable `weight`: KeyError: 'boom'"),
    "name": (
        "criteria",
        "class F:\n" + raises("name") + "    def __call__(self, *_): ...\nf = F()\n",
        "'evil:f', has no readable `name`: KeyError: 'boom'",
    ),
    "signature": (
        "criteria",
        "class F:\n" + raises("__signature__") + "    def __call__(self, *_): ...\nf = F()\n",
        "'evil:f', cannot be read: KeyError: 'boom'",
    ),
    "make_rule": (
        "guidance_rules",
        METHOD + "f = replace(METHODS['steered_noise'], make_rule=no)\n",
        "guidance rule 'evil' failed: KeyError: 'boom'",
    ),
}
AT_USE = ("value", "ragged", "sentence", "save")  # not seen before something is judged, or written


@pytest.mark.parametrize("touched", TOUCHES)
def test_what_raises_wherever_it_is_touched_is_named(touched, tmp_path, monkeypatch, capsys):
    group, source, said = TOUCHES[touched]
    points = f"[dexnudge.{group}]\nevil = evil:f\n"
    make_package(tmp_path, "evil", "import numpy as np\nimport dexnudge as dn\n" + source, points)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "evil", raising=False)
    assert main(["plugins"]) == 0
    listed = capsys.readouterr().out
    assert "  evil, from evil 1.2" in listed
    assert (said in listed) == (touched not in AT_USE)
    flag = {"criteria": "--criterion", "energy_terms": "--term", "guidance_rules": "--method"}[group]
    method = ["--method", RANDOM] if flag != "--method" else []
    out = str(tmp_path / "out")
    assert main(["sample", "phone", "--scene", "table", "--num", "1", *method, flag, "evil", "--out", out]) == 2
    assert said in capsys.readouterr().err


def test_a_package_that_exits_at_import_is_broken_like_any_other(tmp_path, monkeypatch, capsys):
    make_package(tmp_path, "quits", "import sys\nsys.exit(7)\n", "[dexnudge.scenes]\nfog = quits:fog\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["plugins"]) == 0
    listed = capsys.readouterr().out
    assert "fog, from quits 1.2; broken: scene 'fog' of package quits 1.2 cannot be imported" in listed
    assert "guidance rule:" in listed
    assert main(["sample", "phone", "--scene", "fog", "--out", str(tmp_path / "out")]) == 2
    assert "scene 'fog' of package quits 1.2 cannot be imported" in capsys.readouterr().err


def test_ctrl_c_during_an_import_passes_through(tmp_path, monkeypatch):
    make_package(tmp_path, "stopped", "raise KeyboardInterrupt\n", "[dexnudge.scenes]\nfog = stopped:fog\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        load_plugin("scene", "fog")


def test_a_built_in_criterion_may_be_named(broken):
    assert named_criteria(["contact"]) == dn.default_criteria()
    assert [each.name for each in named_criteria(["contact", "explodes"])][-2:] == ["force_margin", "explodes"]


def test_a_built_in_name_cannot_be_taken_over(broken):
    assert dn.find_criterion("contact") in dn.default_criteria()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--scene", "fog"], "scene 'fog' of package bad_import 1.2"),
        (["--scene", "table", "--criterion", "none"], "criterion 'none' of package strange 1.2"),
        (["--scene", "table", "--criterion", "explodes"], "criterion 'explodes' failed: Own: of its own"),
        (["--scene", "table", "--term", "explodes"], "energy term 'explodes' failed: Own: of its own"),
        (["--scene", "table", "--method", "wild"], "guidance rule 'wild' failed: Own: of its own"),
    ],
)
def test_the_command_line_exits_with_2_and_leaves_nothing_behind(broken, options, message, tmp_path, capsys):
    out = tmp_path / "results" / "out"
    method = [] if "--method" in options else ["--method", RANDOM]
    assert main(["sample", "phone", *options, *method, "--num", "1", "--out", str(out)]) == 2
    assert f"dexnudge: {message}" in capsys.readouterr().err
    assert not out.parent.exists()
