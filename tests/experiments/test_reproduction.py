"""A reproduction asks for every trial, goes on where it was stopped, and reports every figure that it asked for."""

import json
import re
from contextlib import closing
from dataclasses import asdict, replace

import pytest

from dexnudge.errors import InputError, OutputError
from dexnudge.experiments.comparisons import MAIN
from dexnudge.experiments.config import ExperimentConfig, trial_keys
from dexnudge.experiments.disturbances import VERIFIED_AT, setting_name
from dexnudge.experiments.records import RecordWriter
from dexnudge.experiments.reproduction import HARD_SCENES, NEW_SCENES, ReproductionConfig, left_out, parts, reproduce
from dexnudge.experiments.run import FILE, FORMAT_VERSION
from dexnudge.experiments.sampling_records import SamplingRecord
from dexnudge.jobs.claims import claim_folder
from dexnudge.sampling.methods import METHODS

COMMON = ExperimentConfig(objects="builtin:test", max_objects=3, scenes=("table", "shelf", "slot"), num=8, data="data")
CONFIG = ReproductionConfig(
    common=COMMON, grasp_weights="grasps", prediction_weights={"epsilon": "noise", "sample": "clean"}
)
FOLDERS = [
    "with_base",
    "without_base",
    "grasps_only",
    "predictions-epsilon",
    "predictions-sample",
    "hard",
    "generalisation",
]
SETTINGS = [setting_name(*each) for each in VERIFIED_AT]
GOOD = {"steered_noise": 7, "paper": 4, "guidance_only": 1}  # of 8 draws; 2 of every other method


def with_common(**changes):
    return replace(CONFIG, common=replace(COMMON, **changes))


def test_every_method_is_asked_for_with_the_forearm_and_the_tables_without():
    with_base, without_base, grasps, *_ = parts(CONFIG)
    assert set(with_base.config.methods) == set(METHODS)
    assert len(with_base.config.methods) == len(METHODS)
    assert with_base.config.base
    assert not without_base.config.base
    assert {*MAIN, "guidance_only", "grasp_projection"} <= set(without_base.config.methods)
    assert without_base.config.data is None
    assert (grasps.config.methods, grasps.config.weights) == (("grasp_projection",), "grasps")
    assert [part.config.sweep for part in (with_base, without_base)] == [True, False]


def test_hard_and_new_scenes_and_other_models_have_parts_of_their_own():
    found = {part.folder: part.config for part in parts(CONFIG)}
    assert list(found) == FOLDERS
    assert (found["hard"].scenes, found["hard"].methods) == (HARD_SCENES, MAIN)
    assert (found["generalisation"].scenes, found["generalisation"].methods) == (NEW_SCENES, MAIN)
    for name, folder in CONFIG.prediction_weights.items():
        assert found[f"predictions-{name}"] == replace(COMMON, weights=folder, methods=("steered_noise",), data=None)


def test_another_hand_is_that_of_every_part():
    assert {part.config.hand for part in parts(with_common(hand="shadow_full"))} == {"shadow_full"}


def test_what_a_run_cannot_have_is_named():
    assert left_out(CONFIG) == []
    bare = ReproductionConfig(common=replace(COMMON, data=None), quick=True)
    asked = {method for part in parts(bare) for method in part.config.methods}
    assert left_out(bare) == [
        "part hard: left out by --quick",
        "part generalisation: left out by --quick",
        "nearest_pose: needs a dataset, --data DIR",
        "a model trained on grasps only: needs its folder, --grasp-weights DIR",
        "other prediction types: need models, --prediction-weights NAME=DIR ...",
        *(f"{each}: left out by --quick" for each in METHODS if each not in {*asked, "nearest_pose"}),
    ]


def test_parts_and_methods_are_chosen():
    plain = replace(CONFIG, grasp_weights=None, prediction_weights={})
    some = replace(plain, parts=("hard", "with_base"), methods=("steered_noise", "paper"))
    assert [(part.folder, part.config.methods) for part in parts(some)] == [
        ("with_base", ("steered_noise", "paper")),
        ("hard", ("steered_noise",)),
    ]
    assert "part grasps_only: left out by --parts" in left_out(some)
    assert "clean_gradient: left out by --methods" in left_out(some)
    with pytest.raises(InputError, match="unknown part 'harder'"):
        parts(replace(CONFIG, parts=("harder",)))
    with pytest.raises(InputError, match=r"has the method 'nearest_pose'; expected some of .*needs `data`"):
        parts(replace(with_common(data=None), methods=("nearest_pose",)))
    with pytest.raises(InputError, match="grasps_only needs `grasp_weights`"):
        parts(replace(plain, common=replace(COMMON, data=None), parts=("grasps_only",)))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run in which every trial is recorded; the first object fails in the slot. (folder, text of the report)."""
    out = tmp_path_factory.mktemp("runs") / "out"
    claim_folder(out, "reproduction.json", CONFIG.as_claim(), format_version=FORMAT_VERSION, device="cpu")
    for part in parts(CONFIG):
        folder, claim = out / part.folder, asdict(part.config)
        claim_folder(folder, FILE, claim, format_version=FORMAT_VERSION, device="cpu")
        with closing(RecordWriter(folder)) as writer:
            for key in trial_keys(part.config):
                writer.append(_record(key))
    return out, reproduce(CONFIG, out, workers=1)


def _record(key):
    common = {**key._asdict(), "seed": 0, "num": 8}
    if key.scene == "slot" and key.object == "phone-200":
        return SamplingRecord(**common, status="failed", reason="SceneError: too thick")
    good = GOOD.get(key.method, 2)
    success = [True] * good + [False] * (8 - good)
    return SamplingRecord(
        **common,
        verified=good,
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


def test_the_report_has_every_figure_that_was_asked_for(finished):
    out, text = finished
    assert (out / "report.md").read_text() == text
    content = json.loads((out / "report.json").read_text())
    asked = {
        (part.folder, scene, method)
        for part in parts(CONFIG)
        for scene in part.config.scenes
        for method in part.config.methods
    }
    assert {(row["part"], row["scene"], row["method"]) for row in content["metrics"]} == asked
    for folder in FOLDERS:
        own = json.loads((out / folder / "report.json").read_text())
        assert {(folder, row["scene"], row["method"]) for row in own["metrics"]} == {k for k in asked if k[0] == folder}
        assert f"({folder}/report.md)" in text
        assert ("At equal time on the wall clock" in own["sections"]) == (folder in FOLDERS[:2] + FOLDERS[-2:])
    settings = json.loads((out / "with_base" / "report.json").read_text())["sections"]["At other frictions and masses"]
    assert len({row["setting"] for row in settings}) == 1 + len(SETTINGS)
    assert "- phone-200, slot: SceneError: too thick" in text
    assert "Nothing is missing." in text


def test_attempted_is_the_denominator_everywhere(finished):
    for row in json.loads((finished[0] / "report.json").read_text())["metrics"]:
        done = 2 / 3 if row["scene"] == "slot" else 1.0  # of the objects
        assert row["single"]["value"] == pytest.approx(GOOD.get(row["method"], 2) / 8 * done)
        assert row["top"]["value"] == pytest.approx(done)


def test_the_papers_numbers_stand_beside_ours(finished):
    text = finished[1]
    assert "| table | steered_noise | with the forearm | 73.2 | 87.5 (88-88) | 100.0 (100-100) | 100.0" in text
    assert "| table | steered_noise | without the forearm | 73.2 | 87.5 (88-88) |" in text
    assert "| shelf | grasp_projection | a model trained on grasps only | 0.0 | 25.0 (25-25) |" in text
    assert "| table | guidance_only | with the forearm | 26.8 | 0.0 | 100.0 (100-100) | 12.5 (12-12) |" in text
    assert "| slot | steered_noise | with the forearm |  | " in text


def test_the_main_table_has_no_prior_below_ours(finished):
    text = finished[1].split("## Main table")[1].split("##")[0]
    scenes = [*COMMON.scenes, *HARD_SCENES, *NEW_SCENES]
    found = [line.split(" | ")[:2] for line in text.splitlines() if line.startswith("| ")][2:]
    assert sorted(map(tuple, found)) == sorted((f"| {scene}", each) for scene in scenes for each in MAIN)


def test_other_models_stand_beside_the_runs_own(finished):
    text = finished[1].split("## Prediction types")[1].split("\n## ")[0]
    rows = [line.split(" | ")[:4] for line in text.splitlines() if line.startswith("| table | steered_noise |")]
    assert [row[2] for row in rows] == ["the run's own", "Weights epsilon", "Weights sample"]


def test_the_worst_cases_are_shown(finished):
    worst = re.findall(r"## (\S+), (\S+): 7 of 8 draws of steered_noise\n", finished[1])
    assert len({scene for _, scene in worst}) == len(worst) == 3


def test_other_options_and_other_folders_are_refused(finished, tmp_path):
    with pytest.raises(InputError, match="seed is 0 there and 1 here"):
        reproduce(with_common(seed=1), finished[0], workers=1)
    (tmp_path / "thesis.tex").write_text("years")
    with pytest.raises(OutputError, match="holds no experiment"):
        reproduce(CONFIG, tmp_path, workers=1)


def test_bad_options_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match="unknown scene 'tabel'"):
        reproduce(with_common(scenes=("tabel",)), tmp_path / "out", workers=1)
    assert not (tmp_path / "out").exists()
