"""`dexnudge evaluate --scan` from objects to what is true and executed, and options that it refuses."""

import json

import pytest
import trimesh


@pytest.mark.slow
def test_scans_are_sampled_in_and_judged_in_the_true_scene(dexnudge, tmp_path):
    (tmp_path / "objects").mkdir()
    trimesh.creation.box((0.15, 0.07, 0.02)).export(tmp_path / "objects" / "box.obj")
    out = tmp_path / "out"
    command = ["evaluate", "--objects", tmp_path / "objects", "--scenes", "table", "--num", 4, "--workers", 1]
    errors = ["--scan", "--noise-mm", 0.5, "--tilt-deg", 0.5, "--pose-mm", 1, "--pose-deg", 0.5, "--triangle-mm", 20]
    outcome = dexnudge(*command, *errors, "--execute", "--out", out)
    assert outcome.code == 0
    assert "# Sampled in scans, judged in the true scene" in outcome.out
    (record,) = (json.loads(line) for line in (out / "scan" / "results.jsonl").read_text().splitlines())
    assert record["refused"] == record["reason"] == ""
    assert len(record["true"]) == record["verified"] > 0
    assert record["true"][0]
    assert record["outcome"] == "success"
    assert 0.8 * record["length_asked"] < record["length_reached"]
    assert 0.2e-3 < record["surface_noise"] < 1e-3
    assert 0 < record["pose_error_mm"] < 1.2  # it settled on its support, and stays off beside it
    claim = json.loads((out / "scan" / "experiment.json").read_text())["config"]
    assert claim["scan_errors"]["tilt_deg"] == 0.5
    refused = dexnudge(*command, "--scan", "--noise-mm", 1, "--execute", "--out", out)
    assert refused.code == 2
    assert "scan_errors" in refused.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--noise-mm", 1], "--noise-mm is given without --scan; expected both; add --scan, or leave it out"),
        (
            ["--scan", "--open-loop"],
            "--open-loop is given without --execute; expected both; add --execute, or leave it out",
        ),
        (
            ["--scan", "--execute", "--open-loop"],
            "--scan and --open-loop are both given; expected one of them; run them one after the other",
        ),
        (["--scan", "--pose-mm", -1], "--pose-mm is -1; expected 0 to 50"),
        (
            ["--scan", "--then-grasp"],
            "--scan and --then-grasp are both given; expected one of them; run them one after the other",
        ),
    ],
)
def test_options_that_do_not_go_together_are_refused(dexnudge, tmp_path, options, message):
    outcome = dexnudge("evaluate", "--objects", "builtin:test", "--out", tmp_path / "out", *options)
    assert (outcome.code, outcome.err) == (2, f"dexnudge: {message}\n")
    assert not (tmp_path / "out").exists()
