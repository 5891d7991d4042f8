"""Figures of plans for an arm, found by hand; and one object from its mesh to what the arm did with it."""

import json

import pytest
import trimesh

from dexnudge.cli.main import main
from dexnudge.experiments.arm_trial import ArmRecord, ArmTrial
from dexnudge.experiments.metrics import measure
from dexnudge.trajectories.planner import Failure


def record(name, *, plan=None, outcome="", depth=0.1, failures=(), seconds=1.0, **given):
    """A trial whose configuration of rank `plan` is planned, and ends so when it is played."""
    planned = {
        "configuration": plan,
        "limits": dict.fromkeys(("position", "velocity", "acceleration", "jerk"), 0.5 + depth),
        "penetration_mm": {"object": depth, "environment": 0.0, "self_collision": 2 * depth},
        "phases": {"push": 10 * depth},
    }
    played = {"outcome": outcome, "length_asked": 0.1, "length_reached": 0.05, "palm_error_mm": depth}
    common = {"object": name, "scene": "table", "method": "steered_noise", "seed": 0, "num": 4, "verified": 2}
    return ArmRecord(
        **{**common, **given},
        **(planned if plan is not None else {}),
        **(played if outcome else {}),
        failures=[Failure(number, *one) for number, one in enumerate(failures)],
        seconds={"plan": seconds} if given.get("status", "done") == "done" else {},
    )


@pytest.fixture
def records():
    blocked = ("contact", "'link3' is 4 mm from the object at (0.10, 0.20, 0.30) m")
    again = ("contact", "'link3' is 1 mm from the object at (0.10, 0.21, 0.30) m")
    return [
        record("a", plan=0, outcome="success", seconds=1.0),
        record("b", plan=1, outcome="turned", depth=0.3, failures=[blocked], seconds=2.0),
        record("c", failures=[blocked, again, ("push", "out of reach")], seconds=9.0),
        record("d", status="unverified", verified=0),
        record("e", status="failed", reason="ArmError: no place", verified=0),
    ]


def test_what_was_attempted_is_the_denominator(records):
    (row,) = measure(records, ArmTrial.metrics)
    assert (row["objects"], row["failed"], row["unverified"]) == (5, 1, 1)
    assert (row["planned"].value, row["executed"].value) == (pytest.approx(0.4), pytest.approx(0.2))
    assert row["executed_of_planned"].value == pytest.approx(0.5)
    assert row["outcomes"] == {
        "played: turned": 1,
        "no plan: contact": 1,
        "no draw verified and reached": 1,
        "object failed": 1,
    }
    assert [each.succeeded for each in records] == [True, False, False, False, False]


def test_seconds_are_of_all_that_was_planned_for_and_figures_the_worst_of_the_plans(records):
    (row,) = measure(records, ArmTrial.metrics)
    assert (row["plan_median"].value, row["plan_most"].value) == (2.0, 9.0)
    assert row["plan_median"].low == 1.0
    assert row["plan_median"].high == 9.0
    assert (row["jerk_limit"], row["in_object_mm"], row["in_itself_mm"]) == (0.8, 0.3, 0.6)
    assert (row["palm_error_mm"], row["advance"].value) == (0.3, pytest.approx(0.5))
    (nothing,) = measure(records[2:], ArmTrial.metrics)
    assert nothing["executed"] is nothing["executed_of_planned"] is nothing["jerk_limit"] is None


def test_a_plan_that_goes_on_to_a_lift_succeeds_with_the_lift():
    lifts = [record(name, plan=0, outcome="success", lift=lift) for name, lift in (("a", "success"), ("b", "slipped"))]
    (row,) = measure(lifts, ArmTrial.metrics)
    assert (row["executed"].value, row["lifted"].value) == (1.0, 0.5)
    assert row["outcomes"] == {"played: lift, slipped": 1}
    assert [each.succeeded for each in lifts] == [True, False]


def test_reasons_are_counted_without_their_numbers_and_phases_have_a_table(records):
    why, phases = ArmTrial("panda").sections(records)
    assert why.table.rows == [
        ["table", "contact", "'link#' is # mm from the object at (#, #, #) m", 3, 2],
        ["table", "push", "out of reach", 1, 1],
    ]
    assert phases.table.rows == [["table", "2.00"]]


@pytest.mark.slow  # draws, plans, plays
def test_an_object_is_planned_for_and_pushed_and_a_second_call_computes_nothing_anew(tmp_path, capsys):
    (tmp_path / "objects").mkdir()
    trimesh.creation.box((0.15, 0.07, 0.02)).export(tmp_path / "objects" / "box.obj")
    out = tmp_path / "out"
    command = ["evaluate", "--arm", "panda", "--base-distance", "0.5", "0.7", "--objects", str(tmp_path / "objects")]
    command += ["--scenes", "table", "--num", "8", "--workers", "1", "--execute", "--out", str(out)]
    assert main(command) == 0
    text = capsys.readouterr().out
    assert "# Planned for an arm" in text
    before = (out / "arm" / "results.jsonl").read_bytes()
    (row,) = map(json.loads, before.splitlines())
    assert (row["status"], row["outcome"]) == ("done", "success")
    assert 0.5 <= row["base_distance"] <= 0.7
    assert 0 <= row["configuration"] < row["verified"] <= 8
    assert list(row["phases"]) == ["pre-contact", "contact", "squeeze", "push", "retreat"]
    assert sum(row["phases"].values()) == pytest.approx(row["duration"], abs=1e-3)
    assert max(row["limits"].values()) <= 1 + 1e-6
    assert max(row["penetration_mm"].values()) <= 1.0
    assert row["length_reached"] >= 0.8 * row["length_asked"]
    assert {"draw", "plan", "plan: transit", "measure", "execute"} <= set(row["seconds"])
    assert main(command) == 0
    assert (out / "arm" / "results.jsonl").read_bytes() == before
    assert capsys.readouterr().out == text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--base-distance", "0.5"], "--base-distance given without --arm; name the arm, or leave it out"),
        (
            ["--arm", "panda", "--base-distance", "0.7", "0.5"],
            "--base-distance is 0.7 0.5; expected one number, or FROM TO with FROM at most TO, from 0.1 to 3 m",
        ),
        (
            ["--arm", "panda", "--arm-base", "1", "0", "0", "--base-distance", "0.5"],
            "--arm-base and --base-distance are both given; expected one of them",
        ),
        (
            ["--arm", "panda", "--scan"],
            "--arm and --scan are both given; expected one of them; run them one after the other",
        ),
    ],
)
def test_options_that_do_not_go_together_are_refused(tmp_path, capsys, options, message):
    assert main(["evaluate", "--objects", "builtin:test", "--out", str(tmp_path / "out"), *options]) == 2
    assert capsys.readouterr().err == f"dexnudge: {message}\n"
    assert not (tmp_path / "out").exists()
