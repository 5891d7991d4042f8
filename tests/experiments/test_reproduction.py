"""A reproduction asks for every row, goes on where it was stopped, and reports every row that it asked for."""

import json
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from dexnudge.errors import InputError, OutputError
from dexnudge.experiments import experiments, reproduction_report
from dexnudge.experiments.method_names import method_name
from dexnudge.experiments.paper_tables import TABLE_1, TABLE_2
from dexnudge.experiments.rejected_pictures import RejectedDraw
from dexnudge.experiments.reproduction import read_reproduction, run_reproduction
from dexnudge.experiments.reproduction_parts import (
    HARD_SCENES,
    MAIN,
    NEW_SCENES,
    ReproductionConfig,
    left_out,
    parts,
)
from dexnudge.experiments.reproduction_report import write_reproduction_report
from dexnudge.experiments.rows import FILE, Row, read_rows
from dexnudge.experiments.sweeps import SWEEPS, setting_name
from dexnudge.sampling.methods import METHODS

CONFIG = ReproductionConfig(
    max_objects=3,
    scenes=("table", "shelf", "slot"),
    num=8,
    grasp_weights="grasps",
    prediction_weights={"epsilon": "noise", "sample": "clean"},
    data="data",
)
SIZES = {"with_base": 15 * 9, "without_base": 6 * 9, "grasps_only": 9, "predictions-epsilon": 9}
SIZES |= {"predictions-sample": 9, "hard": 2 * 12, "generalisation": 2 * 9}
SETTINGS = [setting_name(quantity, factor) for quantity, factors in SWEEPS.items() for factor in factors]


class InstantRowMaker:
    """Rows without sampling; the first object fails in the slot."""

    made: list[tuple[str, ...]] = []  # noqa: RUF012  shared on purpose: the test looks at it

    def __init__(self, config):
        self.config = config

    def __call__(self, task):
        self.made.append((task.object, task.scene, task.method, self.config.base, self.config.weights))
        if task.scene == "slot" and task.object == "phone-200":
            return experiments.failed_row(self.config, task, "SceneError: too thick")
        good = {"steered_noise": 7, "paper": 4, "guidance_only": 1}.get(task.method, 2)
        success = [True] * good + [False] * (8 - good)
        return Row(
            object=task.object,
            scene=task.scene,
            method=task.method,
            status="sampled",
            num=8,
            seed=0,
            success=success,
            force_margin=[2.0] * good + [0.5] * (8 - good),
            penetration_mm=[0.5] * 8,
            own_rank=[*range(8)],
            joint_diversity=0.2,
            contact_diversity=0.4,
            swept=dict.fromkeys(SETTINGS, success),
            rejected={"force": 8 - good},
            seconds={"load": 0.1, "prepare": 1.0, "draw": 1.0},
        )


@pytest.fixture(autouse=True)
def instant(monkeypatch):
    InstantRowMaker.made = []
    monkeypatch.setattr(experiments, "RowMaker", InstantRowMaker)
    monkeypatch.setattr(reproduction_report, "picture_rejected", lambda cases, folder: [None] * len(cases))


@pytest.fixture
def finished(tmp_path):
    run_reproduction(CONFIG, tmp_path / "out", workers=1)
    return tmp_path / "out"


def test_every_method_is_asked_for_with_the_forearm_and_the_tables_without():
    with_base, without_base, grasps, *_ = parts(CONFIG)
    assert set(with_base.config.methods) == set(METHODS)
    assert len(with_base.config.methods) == len(METHODS)
    assert with_base.config.base
    assert not without_base.config.base
    assert {"steered_noise", "guidance_only", "grasp_projection", "random_start_projection"} <= set(
        without_base.config.methods
    )
    assert without_base.config.data is None
    assert (grasps.config.methods, grasps.config.weights) == (("grasp_projection",), "grasps")
    assert all(part.config.num == 8 and part.config.sweep == (part is with_base) for part in [with_base, without_base])


def test_hard_and_new_scenes_and_other_models_have_parts_of_their_own():
    found = {part.folder: part.config for part in parts(CONFIG)}
    assert list(found) == list(SIZES)
    assert (found["hard"].scenes, found["hard"].methods) == (HARD_SCENES, MAIN)
    assert (found["generalisation"].scenes, found["generalisation"].methods) == (NEW_SCENES, MAIN)
    for name, folder in CONFIG.prediction_weights.items():
        theirs = found[f"predictions-{name}"]
        assert (theirs.weights, theirs.methods) == (folder, ("steered_noise",))
        assert replace(theirs, weights=None, methods=()) == replace(
            found["with_base"], methods=(), sweep=False, data=None
        )


def test_what_a_run_cannot_have_is_named():
    assert left_out(CONFIG) == []
    bare = replace(CONFIG, data=None, grasp_weights=None, prediction_weights={}, quick=True)
    asked = {method for part in parts(bare) for method in part.config.methods}
    assert left_out(bare) == [
        "part hard: left out by --quick",
        "part generalisation: left out by --quick",
        "nearest training pose + projection: needs a dataset, --data DIR",
        "a model trained on grasps only: needs its folder, --grasp-weights DIR",
        "other prediction types: need models, --prediction-weights NAME=DIR ...",
        *(f"{method_name(each)}: left out by --quick" for each in METHODS if each not in {*asked, "nearest_pose"}),
    ]


def test_parts_and_methods_are_chosen():
    some = replace(CONFIG, parts=("hard", "with_base"), methods=("steered_noise", "paper"))
    assert [(part.folder, part.config.methods) for part in parts(some)] == [
        ("with_base", ("steered_noise", "paper")),
        ("hard", ("steered_noise",)),
    ]
    assert "part grasps_only: left out by --parts" in left_out(some)
    assert "MPGD + projection: left out by --methods" in left_out(some)
    with pytest.raises(InputError, match="unknown part 'harder'; expected some of with_base, without_base"):
        parts(replace(CONFIG, parts=("harder",)))
    with pytest.raises(InputError, match=r"has the method 'nearest_pose'; expected some of ours, .*needs --data"):
        parts(replace(CONFIG, data=None, methods=("nearest_pose",)))
    with pytest.raises(InputError, match="grasps_only needs --grasp-weights"):
        parts(replace(CONFIG, grasp_weights=None, parts=("grasps_only",)))


def test_options_are_read_back_as_they_were_written():
    for config in (CONFIG, replace(CONFIG, parts=("hard",), methods=("steered_noise",))):
        assert ReproductionConfig.from_json(json.loads(json.dumps(config.as_json()))) == config


def test_the_report_has_every_row_that_was_asked_for(finished):
    text = write_reproduction_report(finished)
    content = json.loads((finished / "report.json").read_text())
    asked = {
        (part.folder, scene, method)
        for part in parts(CONFIG)
        for scene in part.config.scenes
        for method in part.config.methods
    }
    assert {(line["part"], line["scene"], line["method"]) for line in content["lines"]} == asked
    assert {(line["part"], line["scene"], line["method"]) for line in content["sweeps"]} == asked
    assert {line["setting"] for line in content["sweeps"]} == {"as drawn", *SETTINGS}
    compared = {(each["part"], each["scene"], each["method"]) for each in content["equal_time"]}
    with_both = ("with_base", "without_base", "hard", "generalisation")
    assert compared == {key for key in asked if key[0] in with_both}
    for _, scene, method in asked:
        assert f"| {scene} | {method_name(method)} | 3 | {int(scene == 'slot')} | 24 |" in text
    assert "- phone-200, slot: SceneError: too thick" in text
    assert "Nothing is missing." in text
    for plot in ["with_base-single", "with_base-speed", "with_base-sweeps", "hard-single"]:
        assert f"![{plot}](plots/{plot}.svg)" in text
        assert ElementTree.parse(finished / "plots" / f"{plot}.svg").getroot().get("width")  # noqa: S314  our own


def test_attempted_is_the_denominator_everywhere(finished):
    write_reproduction_report(finished)
    content = json.loads((finished / "report.json").read_text())
    for kind in ("lines", "sweeps"):
        for line in content[kind]:
            good = {"steered_noise": 7, "paper": 4, "guidance_only": 1}.get(line["method"], 2)
            sampled = 2 / 3 if line["scene"] == "slot" else 1.0  # of the objects
            assert line["single"]["value"] == pytest.approx(good / 8 * sampled)
            assert line["top"]["value"] == pytest.approx(sampled)


def test_the_papers_numbers_stand_beside_ours(finished):
    text = write_reproduction_report(finished)
    assert "| table | dexnudge | with the forearm | 73.2 | 87.5 (88-88) | 100.0 (100-100) | 100.0" in text
    assert "| table | dexnudge | without the forearm | 73.2 | 87.5 (88-88) |" in text
    assert "| shelf | dexnudge, asked for grasps | a model trained on grasps only | 0.0 | 25.0 (25-25) |" in text
    assert (
        "| table | dexnudge, not projected | with the forearm | 26.8 | 0.0 | 100.0 (100-100) | 12.5 (12-12) |" in text
    )
    assert "| shelf | Eq. 5 + projection | with the forearm | 73.2 | 63.4 |" in text
    assert "| slot | dexnudge | with the forearm |  | " in text


def test_the_main_table_has_no_prior_below_ours(finished):
    text = write_reproduction_report(finished).split("## Main table")[1].split("##")[0]
    names = [method_name(method) for method in MAIN]
    scenes = [*CONFIG.scenes, *HARD_SCENES, *NEW_SCENES]
    lines = [line for line in text.splitlines() if line.startswith("| ")][2:]
    assert sorted({tuple(line.split(" | ")[:2]) for line in lines}) == sorted(
        {(f"| {scene}", name) for scene in scenes for name in names}
    )
    assert [line.split(" | ")[1] for line in lines[:4]] == names * 2


def test_other_models_stand_beside_the_runs_own(finished):
    text = write_reproduction_report(finished).split("## Prediction types")[1].split("\n## ")[0]
    rows = [line.split(" | ")[:4] for line in text.splitlines() if line.startswith("| table | dexnudge |")]
    assert [row[2] for row in rows] == ["the run's own", "Weights epsilon", "Weights sample"]
    assert rows[0][3] == "87.5 (88-88)"


def test_the_worst_cases_are_shown_with_picture_and_reason(finished, monkeypatch):
    asked = []

    def pictured(cases, folder):
        asked.extend(case.row for case in cases)
        shown = RejectedDraw(
            folder / "failure-1.png", "force", 0.0, 0.0004, 0.0, 0.73, ("ffdistal", "thdistal"), "thdistal"
        )
        return [shown, None, None]

    monkeypatch.setattr(reproduction_report, "picture_rejected", pictured)
    text = write_reproduction_report(finished).split("## Three failures, and why")[1].split("\n## ")[0]
    assert len({row.scene for row in asked}) == 3
    for row in asked:
        assert f"### {row.object}, {row.scene}: 7 of 8 draws of dexnudge succeed" in text
    assert text.count("| force | the contacts cannot move the object") == 3
    assert "![A rejected draw: force](plots/failure-1.png)" in text
    assert "0.40 mm in object, 0.00 mm in hand itself (deepest: thdistal)" in text
    assert "ffdistal, thdistal; force margin 0.73, 1 is needed" in text


def test_the_two_tables_of_the_paper_agree_where_they_overlap():
    assert {scene: row[1][1] for scene, row in TABLE_2.items()} == {scene: row[1] for scene, row in TABLE_1.items()}


def test_a_second_run_computes_only_what_is_missing(finished):
    asked = len(InstantRowMaker.made)
    assert asked == sum(SIZES.values()) == len(InstantRowMaker.made)
    file = finished / "without_base" / FILE
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(b"".join(lines[:-2]) + lines[-2][:30])
    with pytest.raises(InputError, match=r"2 of 54 rows of without_base are missing \(first: .*with the same options"):
        read_reproduction(finished)
    InstantRowMaker.made.clear()
    seen = []
    run_reproduction(CONFIG, finished, workers=1, on_row=lambda row, done, total: seen.append((done, total)))
    assert len(InstantRowMaker.made) == 2
    assert seen == [(15 * 9 + 53, asked), (15 * 9 + 54, asked)]
    assert len(read_rows(finished / "without_base")) == 54


def test_other_options_and_other_folders_are_refused(finished, tmp_path):
    with pytest.raises(InputError, match="seed is 0 there and 1 here"):
        run_reproduction(replace(CONFIG, seed=1), finished, workers=1)
    (tmp_path / "thesis.tex").write_text("years")
    with pytest.raises(OutputError, match="holds no experiment"):
        run_reproduction(CONFIG, tmp_path, workers=1)
    with pytest.raises(InputError, match=r"reproduction\.json cannot be read"):
        write_reproduction_report(tmp_path)


def test_bad_options_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match="unknown scene 'tabel'"):
        run_reproduction(replace(CONFIG, scenes=("tabel",)), tmp_path / "out", workers=1)
    assert not (tmp_path / "out").exists()
