"""`dexnudge evaluate --then-grasp` from objects to the lifted rate, and input it refuses."""

import json

import pytest
import trimesh


@pytest.mark.slow
def test_an_experiment_is_lifted_and_goes_on_where_it_was_stopped(dexnudge, tmp_path):
    (tmp_path / "objects").mkdir()
    trimesh.creation.box((0.15, 0.07, 0.02)).export(tmp_path / "objects" / "box.obj")
    (tmp_path / "objects" / "broken.obj").write_text("v 0 0 0\n")
    out = tmp_path / "out"
    command = ["evaluate", "--objects", tmp_path / "objects", "--scenes", "table", "--num", 8, "--out", out]
    options = ["--then-grasp", "--attempts", 2, "--workers", 1]
    outcome = dexnudge(*command, *options)
    assert outcome.code == 0
    assert "# Slid, grasped, lifted" in outcome.out
    file = out / "lifted" / "results.jsonl"
    rows = {row["object"]: row for row in map(json.loads, file.read_text().splitlines())}
    assert {name: row["status"] for name, row in rows.items()} == {"box": "done", "broken": "failed"}
    box, last = rows["box"], rows["box"]["attempts"][-1]
    own = next(row for row in map(json.loads, (out / "results.jsonl").read_text().splitlines()) if row["success"])
    assert (box["verified"], box["seed"]) == (sum(own["success"]), own["seed"])
    assert 1 <= len(box["attempts"]) <= 2
    assert last["phase"] == ""
    assert last["least_held"] >= 0.08
    (row,) = json.loads((out / "lifted" / "report.json").read_text())["metrics"]
    assert (row["objects"], row["failed"]) == (2, 1)
    assert row["lifted"]["value"] == 0.5
    file.write_text(json.dumps(rows["broken"]) + "\n" + json.dumps(box)[:40])
    assert dexnudge(*command, *options).code == 0
    again = {row["object"]: row for row in map(json.loads, file.read_text().splitlines())}
    assert [{**row, "seconds": {}} for row in again.values()] == [
        {**rows[name], "seconds": {}} for name in ("broken", "box")
    ]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--then-grasp", "--attempts", 0], "--attempts is 0; expected at least 1"),
        (
            ["--attempts", 2],
            "--attempts is given without --then-grasp; expected both; add --then-grasp, or leave it out",
        ),
    ],
)
def test_attempts_that_make_no_sense_are_refused(dexnudge, tmp_path, options, message):
    outcome = dexnudge("evaluate", "--objects", "builtin:test", "--out", tmp_path / "out", *options)
    assert outcome.code == 2
    assert outcome.err == f"dexnudge: {message}\n"
    assert not (tmp_path / "out").exists()
