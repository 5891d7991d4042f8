"""What installed packages bring: the example package, used by name, and packages that are broken."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dexnudge as dn
from dexnudge.cli.main import main
from dexnudge.plugins import find_plugins, load_plugin, plugin_names, usable_plugins

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
    for name in ("ice", "high_palm", "palm_height", "dexnudge-example 0.1.0"):
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
    found = {plugin.name: plugin for plugin in find_plugins("criterion", builtin=("contact",))}
    assert "has no attribute 'missing'" in found["none"].broken
    assert found["misnamed"].broken == ""
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
    with pytest.raises(dn.InputError, match="criterion 'misnamed' of a package is named 'other'"):
        dn.find_criterion("misnamed")


def test_a_name_that_nobody_brings(broken):
    with pytest.raises(dn.UnknownNameError, match=r"unknown criterion 'conntact' \(did you mean 'contact'\?\)"):
        dn.find_criterion("conntact")


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
