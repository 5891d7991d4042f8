"""A reproduction asks for every row, goes on where it was stopped, and reports every row that it asked for."""

import json
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from dexnudge.errors import InputError, OutputError
from dexnudge.evaluation import experiments
from dexnudge.evaluation.paper_tables import TABLE_1, TABLE_2
from dexnudge.evaluation.reproduction import ReproductionConfig, left_out, parts, read_reproduction, run_reproduction
from dexnudge.evaluation.reproduction_report import write_reproduction_report
from dexnudge.evaluation.rows import FILE, Row, read_rows
from dexnudge.evaluation.sweeps import SWEEPS, setting_name
from dexnudge.sampling.methods import METHODS

CONFIG = ReproductionConfig(
    max_objects=3, scenes=("table", "shelf", "slot"), num=8, grasp_weights="grasps", data="data"
)
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
        good = {"ours": 7, "paper": 4, "guidance_only": 1}.get(task.method, 2)
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
            joint_spread=0.2,
            contact_spread=0.4,
            swept=dict.fromkeys(SETTINGS, success),
            rejected={"force": 8 - good},
            seconds={"load": 0.1, "prepare": 1.0, "draw": 1.0},
        )


@pytest.fixture(autouse=True)
def instant(monkeypatch):
    InstantRowMaker.made = []
    monkeypatch.setattr(experiments, "RowMaker", InstantRowMaker)


@pytest.fixture
def finished(tmp_path):
    run_reproduction(CONFIG, tmp_path / "out", workers=1)
    return tmp_path / "out"


def test_every_method_is_asked_for_with_the_forearm_and_the_tables_without():
    with_base, without_base, grasps = parts(CONFIG)
    assert set(with_base.config.methods) == set(METHODS)
    assert len(with_base.config.methods) == len(METHODS)
    assert with_base.config.base
    assert not without_base.config.base
    assert {"ours", "guidance_only", "grasp_projection", "random_start_projection"} <= set(without_base.config.methods)
    assert without_base.config.data is None
    assert (grasps.config.methods, grasps.config.weights) == (("grasp_projection",), "grasps")
    assert all(part.config.sweep and part.config.num == 8 for part in parts(CONFIG))


def test_what_a_run_cannot_have_is_named():
    assert left_out(CONFIG) == []
    bare = replace(CONFIG, data=None, grasp_weights=None, quick=True)
    named = left_out(bare)
    asked = {method for part in parts(bare) for method in part.config.methods}
    assert named[:2] == [
        "nearest_pose: needs a dataset, --data DIR",
        "a model trained on grasps only: needs its folder, --grasp-weights DIR",
    ]
    assert {line.split(":")[0] for line in named} - {"a model trained on grasps only"} == set(METHODS) - asked


def test_the_report_has_every_row_that_was_asked_for(finished):
    text = write_reproduction_report(finished)
    content = json.loads((finished / "report.json").read_text())
    asked = {
        (part.folder, scene, method)
        for part in parts(CONFIG)
        for scene in CONFIG.scenes
        for method in part.config.methods
    }
    assert {(line["part"], line["scene"], line["method"]) for line in content["lines"]} == asked
    assert {(line["part"], line["scene"], line["method"]) for line in content["sweeps"]} == asked
    assert {line["setting"] for line in content["sweeps"]} == {"as drawn", *SETTINGS}
    compared = {(each["part"], each["scene"], each["baseline"]) for each in content["equal_time"]}
    assert compared == {
        (part, scene, baseline)
        for part, baselines in [
            ("with_base", ("random_start_projection", "nearest_pose")),
            ("without_base", ("random_start_projection",)),
        ]
        for scene in CONFIG.scenes
        for baseline in baselines
    }
    for _, scene, method in asked:
        assert f"| {scene} | {method} | 3 | {int(scene == 'slot')} | 24 |" in text
    assert "- phone-200, slot: SceneError: too thick" in text
    assert "Nothing is missing." in text
    for plot in content["left_out"] or [
        "with_base-single",
        "with_base-speed",
        "with_base-sweeps",
        "grasps_only-single",
    ]:
        assert f"![{plot}](plots/{plot}.svg)" in text
        assert ElementTree.parse(finished / "plots" / f"{plot}.svg").getroot().get("width")  # noqa: S314  our own


def test_attempted_is_the_denominator_everywhere(finished):
    write_reproduction_report(finished)
    content = json.loads((finished / "report.json").read_text())
    for kind in ("lines", "sweeps"):
        for line in content[kind]:
            good = {"ours": 7, "paper": 4, "guidance_only": 1}.get(line["method"], 2)
            sampled = 2 / 3 if line["scene"] == "slot" else 1.0  # of the objects
            assert line["single"]["value"] == pytest.approx(good / 8 * sampled)
            assert line["top"]["value"] == pytest.approx(sampled)


def test_the_papers_numbers_stand_beside_ours(finished):
    text = write_reproduction_report(finished)
    assert "| table | ours | with the forearm | 73.2 | 87.5 (88-88) | 100.0 (100-100) | 100.0" in text
    assert "| table | ours | without the forearm | 73.2 | 87.5 (88-88) |" in text
    assert "| shelf | grasps only | a model trained on grasps only | 0.0 | 25.0 (25-25) |" in text
    assert "| table | ours, guidance only | with the forearm | 26.8 | 0.0 | 100.0 (100-100) | 12.5 (12-12) |" in text
    assert "| shelf | Eq. 5, guidance + projection | with the forearm | 73.2 | 63.4 |" in text
    assert "| slot | ours | with the forearm |  | " in text


def test_the_two_tables_of_the_paper_agree_where_they_overlap():
    assert {scene: row[1][1] for scene, row in TABLE_2.items()} == {scene: row[1] for scene, row in TABLE_1.items()}


def test_a_second_run_computes_only_what_is_missing(finished):
    asked = len(InstantRowMaker.made)
    assert asked == len(set(InstantRowMaker.made)) == 3 * 3 * (13 + 6 + 1)
    file = finished / "without_base" / FILE
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(b"".join(lines[:-2]) + lines[-2][:30])
    with pytest.raises(InputError, match=r"2 of 54 rows of without_base are missing \(first: .*with the same options"):
        read_reproduction(finished)
    InstantRowMaker.made.clear()
    seen = []
    run_reproduction(CONFIG, finished, workers=1, on_row=lambda row, done, total: seen.append((done, total)))
    assert len(InstantRowMaker.made) == 2
    assert seen == [(13 * 9 + 53, 180), (13 * 9 + 54, 180)]
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
