"""`dexnudge evaluate --execute` from objects to the executed rate, and input it refuses."""

import json

import pytest
import trimesh

from dexnudge.experiments.disturbances import EXECUTED_AT


@pytest.mark.slow
def test_an_experiment_is_executed_and_a_second_call_computes_nothing_anew(dexnudge, tmp_path):
    (tmp_path / "objects").mkdir()
    trimesh.creation.box((0.15, 0.07, 0.02)).export(tmp_path / "objects" / "box.obj")
    (tmp_path / "objects" / "broken.obj").write_text("v 0 0 0\n")
    out = tmp_path / "out"
    command = ["evaluate", "--objects", tmp_path / "objects", "--scenes", "table", "--num", 8, "--out", out]
    options = ["--execute", "--execute-num", 2, "--execute-errors", "--workers", 1]
    outcome = dexnudge(*command, *options)
    assert outcome.code == 0
    assert "# Executed in physics" in outcome.out
    rows = [json.loads(line) for line in (out / "executed" / "results.jsonl").read_text().splitlines()]
    assert {row["object"]: row["status"] for row in rows} == {"box": "done", "broken": "failed"}
    (box,) = (row for row in rows if row["object"] == "box")
    (own,) = (
        row for row in map(json.loads, (out / "results.jsonl").read_text().splitlines()) if row["object"] == "box"
    )
    assert box["verified"] == sum(own["success"])
    assert len(box["executed"]) == min(2, box["verified"]) > 0
    assert [each["force_margin"] for each in box["executed"]] == own["force_margin"][: len(box["executed"])]
    first = box["executed"][0]
    assert len(first["disturbed"]) == 2 * len(EXECUTED_AT) + 1  # open loop, also as drawn
    (row,) = json.loads((out / "executed" / "report.json").read_text())["metrics"]
    assert (row["objects"], row["failed"]) == (2, 1)
    assert row["top"]["value"] == 0.5 * (first["outcome"] == "success")
    assert row["length_asked_mm"]["value"] == pytest.approx(1e3 * first["length_asked"])
    before = (out / "executed" / "results.jsonl").read_bytes()
    again = dexnudge(*command, *options)
    assert again.out.partition("# Executed")[2] == outcome.out.partition("# Executed")[2]
    assert (out / "executed" / "results.jsonl").read_bytes() == before


def test_a_number_of_executions_below_one_is_refused(dexnudge, tmp_path):
    outcome = dexnudge(
        "evaluate", "--objects", "builtin:test", "--out", tmp_path / "out", "--execute", "--execute-num", 0
    )
    assert outcome.code == 2
    assert outcome.err == "dexnudge: --execute-num is 0; expected at least 1\n"
    assert not (tmp_path / "out").exists()
