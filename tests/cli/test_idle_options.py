"""Options that would do nothing beside others are refused, before anything is written."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from dexnudge.errors import InputError
from dexnudge.experiments.config import ExperimentConfig
from dexnudge.experiments.reproduction import ReproductionConfig, parts

EVALUATE = ("evaluate", "--objects", "builtin:test", "--scenes", "table")
NO_MODEL = ("--method", "random_start_projection", "--weights", "nothing")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("execute", "nothing", "--then-grasp", "--workers", 3), "--workers does nothing with --then-grasp"),
        (("sample", "phone", "--scene", "table", *NO_MODEL), "--weights does nothing with --method random_start_proj"),
        (
            ("sample", "phone", "--scene", "table", "--method", "guidance_only", "--projection-report"),
            "--projection-report does nothing with --method guidance_only",
        ),
        ((*EVALUATE, *NO_MODEL), "--weights does nothing with --method random_start_projection, which draws from no"),
        ((*EVALUATE, "--scan", "--depth-views", 2, "--noise-mm", 1), "--noise-mm does nothing with --depth-views"),
        (("benchmark", "make", "small", "--units", "mm"), "--units is given without --objects"),
    ],
)
def test_options_that_would_do_nothing_are_refused(dexnudge, tmp_path, arguments, message):
    refused = dexnudge(*arguments, "--out", tmp_path / "out")
    assert (refused.code, list(tmp_path.iterdir())) == (2, [])
    assert message in refused.err


@pytest.mark.parametrize(
    ("phase", "options", "message"),
    [
        ("push", ("--workers", 3), "--workers does nothing with a plan"),
        ("push", ("--open-loop",), "--open-loop does nothing with a plan"),
        ("lift", ("--then-grasp", "--attempts", 5), "--attempts does nothing with a plan that lifts the object itself"),
        ("lift", ("--then-grasp", "--seed", 5), "--seed does nothing with a plan that lifts the object itself"),
    ],
)
def test_a_plan_is_played_as_it_is(dexnudge, tmp_path, monkeypatch, phase, options, message):
    (tmp_path / "plan.json").touch()
    plan = SimpleNamespace(phases=[SimpleNamespace(name=phase)])
    monkeypatch.setattr("dexnudge.trajectories.plan_folder.load_plan", lambda _: plan)
    refused = dexnudge("execute", tmp_path, *options, "--out", tmp_path / "out")
    assert refused.code == 2
    assert message in refused.err


@pytest.mark.parametrize(
    ("changed", "part"),
    [
        ({"grasp_weights": "grasps"}, "grasps_only"),
        ({"prediction_weights": {"epsilon": "noise"}}, "predictions"),
        ({"common": ExperimentConfig(objects="builtin:test", data="data")}, "with_base"),
    ],
)
def test_models_and_data_that_no_part_uses_are_refused(changed, part):
    config = replace(ReproductionConfig(common=ExperimentConfig(objects="builtin:test"), parts=("hard",)), **changed)
    with pytest.raises(InputError, match=f"is given without the part {part}, which alone uses it"):
        parts(config)
    assert part in {each.folder.partition("-")[0] for each in parts(replace(config, parts=("hard", part)))}
