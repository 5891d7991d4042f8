"""What is verified in a scan counts only where it is verified in the true scene."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from dexnudge.experiments import scan_trial
from dexnudge.experiments.config import ExperimentConfig, ScanErrors, trial_keys
from dexnudge.experiments.metrics import measure
from dexnudge.experiments.records import read_records
from dexnudge.experiments.run import TrialRunner
from dexnudge.experiments.scan_trial import ScanRecord, ScanTrial, understanding_errors
from dexnudge.experiments.scanned_world import ScannedWorld, scanned_world
from dexnudge.scenes.families import build_scene

EXACT = ScanErrors(triangle_mm=0.0, rounding_mm=0.0)
LOWERED = 0.005  # [m]


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    folder = tmp_path_factory.mktemp("objects")
    trimesh.creation.box((0.15, 0.07, 0.02)).export(folder / "box.obj")
    return ExperimentConfig(objects=str(folder), scenes=("table",), num=4)


def too_low(scene, errors, *, seed):
    """A scan in which all but the truth lies 5 mm too low."""
    world = scanned_world(scene, errors, seed=seed)
    pose, table = world.object_pose.copy(), world.surroundings.copy()
    pose[2, 3] -= LOWERED
    table.apply_translation([0.0, 0.0, -LOWERED])
    return ScannedWorld(world.truth, table, (), pose, world.motion)


def record(name, true=(), **given):
    common = {"scene": "table", "method": "steered_noise", "seed": 0, "num": 4, "verified": len(true)}
    return ScanRecord(
        object=name,
        true=list(true),
        reasons=["" if each else "penetration_object" for each in true],
        **{**common, **given},
    )


def test_the_judge_is_the_true_scene(config, monkeypatch):
    """Also where the scan is wrong, and the scan alone would call every configuration a success."""
    (key,) = trial_keys(config)
    run = ScanTrial(EXACT, execute=False).start(config)
    monkeypatch.setattr(scan_trial, "scanned_world", too_low)
    wrong = run(key)
    assert wrong.verified > 0
    assert not any(wrong.true)
    assert not wrong.succeeded
    assert wrong.pose_error_mm == pytest.approx(5.0, abs=0.01)
    assert all(reason.startswith("penetration") or reason in ("contact", "force_margin") for reason in wrong.reasons)
    assert wrong.penetration_mm[0] > 1.0
    monkeypatch.undo()
    right = run(key)
    assert right.true == [True] * right.verified
    assert right.verified > 0
    assert right.succeeded
    assert (right.pose_error_mm, right.motion_error_deg) == (0.0, 0.0)
    assert right.outcome == wrong.outcome == ""  # neither was played
    assert right.verified + sum(right.rejected.values()) == right.num == 4
    (row,) = measure([right, wrong], ScanTrial.metrics)
    assert (row["top_true"].value, row["any_true"].value) == (0.5, 0.5)
    assert row["true"].value == pytest.approx(right.verified / (right.verified + wrong.verified))


def test_what_was_attempted_is_the_denominator():
    records = [
        record("a", [True, False], outcome="success"),
        record("b", [False, True], outcome="fell_short"),
        record("c"),
        record("d", refused="SceneError: the object touches nothing: 3.0 mm below"),
        record("e", status="failed", reason="MeshError: no"),
    ]
    (row,) = measure(records, ScanTrial.metrics)
    assert (row["objects"], row["failed"], row["refused"]) == (5, 1, 1)
    assert (row["top_true"].value, row["any_true"].value, row["executed"].value) == pytest.approx((0.2, 0.4, 0.2))
    assert row["verified"].value == pytest.approx(4 / 20)
    assert row["true"].value == pytest.approx(0.5)
    assert row["why_not"] == {
        "penetration object": 1,
        "no draw verified in the scan": 1,
        "scan refused": 1,
        "object failed": 1,
    }
    assert row["outcomes"] == {"fell short": 1}


def test_refusals_are_counted_by_what_they_say():
    refused = ["SceneError: 3.0 mm below", "SceneError: 12.5 mm below", "SceneError: blocked"]
    sections = ScanTrial().sections([record(text, refused=text) for text in refused])
    (table,) = (each.table for each in sections if each.title == "Refusals")
    assert table.rows == [["table", "SceneError: # mm below", 2], ["table", "SceneError: blocked", 1]]


def test_a_refused_scan_is_a_record_and_the_run_resumes(config, tmp_path, monkeypatch):
    monkeypatch.setattr("dexnudge.experiments.run.run_tasks_by", in_this_process)
    kind = ScanTrial(replace(EXACT, pose_mm=50.0))
    ((_, first),) = TrialRunner([kind], config, tmp_path).run()
    assert [(each.refused[:12], each.status, each.verified) for each in first] == [("SceneError: ", "done", 0)]
    monkeypatch.setattr("dexnudge.experiments.run.run_tasks_by", pytest.fail)  # nothing is run again
    ((_, again),) = TrialRunner([kind], config, tmp_path).run()
    assert again == first == read_records(tmp_path / "scan", ScanRecord)
    claim = json.loads((tmp_path / "scan" / "experiment.json").read_text())
    assert claim["config"]["scan_errors"]["pose_mm"] == 50.0


def in_this_process(engine, start, keys, **options):
    run = start()
    yield from ((key, run(key)) for key in keys)


def test_errors_of_understanding_are_measured_at_the_objects_centre():
    truth = build_scene("table", "phone", seed=2)
    turn = trimesh.transformations.rotation_matrix(
        np.radians(1.0), [0.0, 0.0, 1.0], truth.object_in_world().center_mass
    )
    turn[0, 3] += 0.002
    tilt = trimesh.transformations.rotation_matrix(np.radians(0.5), np.cross(truth.motion, [0.0, 0.0, 1.0]))
    scan = replace(truth, T_world_object=turn @ truth.T_world_object, motion=tilt[:3, :3] @ truth.motion)
    found = understanding_errors(truth, scan)
    assert found == {"pose_error_mm": 2.0, "pose_error_deg": 1.0, "motion_error_deg": 0.5}
    assert set(understanding_errors(truth, truth).values()) == {0.0}
