"""Lifts of an experiment: what fails is counted, and what is there is not computed again."""

from dataclasses import replace

import pytest
import trimesh

from dexnudge.errors import InputError
from dexnudge.experiments.config import ExperimentConfig, Task
from dexnudge.experiments.lift_experiment import FOLDER, read_lifts, run_lifts
from dexnudge.experiments.lift_experiment_maker import LiftRowMaker
from dexnudge.experiments.rows import FILE, Row, RowWriter


@pytest.fixture
def config(tmp_path):
    """Of three objects: one that cannot be read, one that no shelf holds, and a thin one."""
    objects = tmp_path / "objects"
    objects.mkdir()
    (objects / "broken.obj").write_text("v 0 0 0\n")
    trimesh.creation.box((0.5, 0.5, 0.5)).export(objects / "cube.obj")
    trimesh.creation.box((0.15, 0.07, 0.02)).export(objects / "thin.obj")
    return ExperimentConfig(objects=str(objects), scenes=("shelf",), num=2)


@pytest.fixture
def out(tmp_path):
    """The folder of an experiment that knows of all three that they fail."""
    (tmp_path / "out").mkdir()
    writer = RowWriter(tmp_path / "out")
    common = {"scene": "shelf", "method": "steered_noise", "num": 2, "seed": 7}
    for name in ("broken", "cube"):
        writer.append(Row(object=name, status="failed", reason=f"MeshError: {name}", **common))
    writer.append(Row(object="thin", status="sampled", success=[False] * 2, force_margin=[0.5] * 2, **common))
    writer.close()
    return tmp_path / "out"


def test_what_the_experiment_knows_to_fail_is_counted_and_not_drawn(config, out):
    seen = []
    rows = run_lifts(config, out, on_row=lambda row, done, total: seen.append((row.object, done, total)))
    assert [(row.object, row.status, row.reason, row.drawn) for row in rows] == [
        ("broken", "failed", "MeshError: broken", 0),
        ("cube", "failed", "MeshError: cube", 0),
        ("thin", "failed", "no draw verified", 2),
    ]
    assert seen == [("broken", 1, 3), ("cube", 2, 3), ("thin", 3, 3)]
    assert read_lifts(out)[1] == rows


def test_a_second_run_adds_only_what_is_missing(config, out):
    rows = run_lifts(config, out)
    file = out / FOLDER / FILE
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(lines[0] + lines[1][:25])
    added = []
    assert run_lifts(config, out, on_row=lambda row, *_: added.append(row.object)) == rows
    assert added == ["cube", "thin"]
    assert file.read_bytes().splitlines(keepends=True) == lines


def test_a_line_with_tries_of_another_form_is_refused(config, out):
    run_lifts(config, out)
    file = out / FOLDER / FILE
    file.write_text(file.read_text().replace('"tries": []', '"tries": [{"number": 1}]'))
    with pytest.raises(InputError, match=r"results.jsonl, line 1: TypeError: .*delete the line to have it computed"):
        run_lifts(config, out)


def test_other_options_are_refused_by_name(config, out):
    run_lifts(config, out, tries=3)
    with pytest.raises(InputError, match="holds another experiment: tries is 3 there and 2 here"):
        run_lifts(config, out, tries=2)
    with pytest.raises(InputError, match=r"losses is None there and \{'sweep': 0.0\} here"):
        run_lifts(replace(config, losses={"sweep": 0.0}), out, tries=3)


def test_what_cannot_be_read_or_placed_is_a_failed_row(config):
    maker = LiftRowMaker(config, 1)
    broken, cube = (maker(Task(name, "shelf", "steered_noise")) for name in ("broken", "cube"))
    assert (broken.status, broken.tries, broken.lifted) == ("failed", [], False)
    assert broken.reason.startswith("MeshError: ")
    assert (cube.status, cube.tries, cube.lifted) == ("failed", [], False)
    assert cube.reason.startswith("SceneError: ")


@pytest.mark.slow  # draws twice
def test_an_object_of_which_no_draw_is_verified_is_a_failed_row(config):
    """Hands that nothing brings to the object or keeps out of the shelf."""
    losses = dict.fromkeys(("object", "environment", "self", "contact", "target", "sweep", "base", "force"), 0.0)
    row = LiftRowMaker(replace(config, losses=losses), 1)(Task("thin", "shelf", "steered_noise"))
    assert (row.status, row.reason, row.drawn, row.verified) == ("failed", "no draw verified", 2, 0)
    assert row.seconds["draw"] > 0
