"""Figures of lifts, found by hand; and what cannot be lifted for want of a verified draw."""

import pytest
import trimesh

from dexnudge.execution.slide_grasp_lift import Attempt
from dexnudge.experiments.config import ExperimentConfig, TrialKey
from dexnudge.experiments.lifting_trial import LiftingRecord, LiftingTrial
from dexnudge.experiments.metrics import measure
from dexnudge.planning.outcomes import Outcome

SHORT = ("slide", "stopped_short")


def record(name, *attempts, seconds=1.0, **given):
    """A trial whose attempts end so; ("", "success") is a success."""
    return LiftingRecord(
        object=name,
        method="steered_noise",
        seed=0,
        num=4,
        attempts=[
            Attempt(number, phase, Outcome(outcome)) for number, (phase, outcome) in enumerate(attempts, start=1)
        ],
        simulated=10 * seconds,
        seconds={"draw": seconds, "play": 2 * seconds},
        **{"scene": "table", **given},
    )


@pytest.fixture
def records():
    return [
        record("a", ("", "success")),
        record("b", SHORT, ("", "success"), seconds=3.0),
        record("c", SHORT, ("lift", "slipped"), seconds=2.0),
        record("d", status="failed", reason="MeshError: no"),
        record("e", status="unverified"),
    ]


def test_what_was_attempted_is_the_denominator(records):
    (row,) = measure(records, LiftingTrial.metrics)
    assert (row["objects"], row["failed"], row["unverified"]) == (5, 1, 1)
    assert (row["lifted"].value, row["at_first"].value) == (pytest.approx(0.4), pytest.approx(0.2))
    assert row["lifted"].low < 0.4 < row["lifted"].high
    assert row["outcomes"] == {"lift: slipped": 1, "object failed": 1, "no draw verified": 1}
    assert row["first_outcomes"] == {"slide: stopped short": 2, "object failed": 1, "no draw verified": 1}
    assert sum(row["outcomes"].values()) == 5 - 2


def test_seconds_and_attempts_are_of_what_was_played(records):
    (row,) = measure(records, LiftingTrial.metrics)
    means = [row[name].value for name in ("attempts", "draw", "play", "simulated")]
    assert means == pytest.approx([5 / 3, 2.0, 4.0, 20.0])
    (nothing,) = measure(records[3:], LiftingTrial.metrics)
    assert (nothing["lifted"].value, nothing["attempts"], nothing["play"]) == (0.0, None, None)


def test_scenes_have_figures_of_their_own(records):
    rows = measure([*records, record("a", ("", "success"), scene="shelf")], LiftingTrial.metrics)
    assert [(row["scene"], row["objects"], row["lifted"].value) for row in rows] == [
        ("table", 5, 0.4),
        ("shelf", 1, 1.0),
    ]


@pytest.mark.slow  # draws
def test_an_object_without_a_verified_draw_is_no_failed_one(tmp_path):
    """Hands that nothing brings to the object or keeps out of the shelf."""
    trimesh.creation.box((0.15, 0.07, 0.02)).export(tmp_path / "thin.obj")
    losses = dict.fromkeys(("object", "environment", "self", "contact", "target", "sweep", "base", "force"), 0.0)
    config = ExperimentConfig(objects=str(tmp_path), scenes=("shelf",), num=2, losses=losses)
    found = LiftingTrial(attempts=1).start(config)(TrialKey("thin", "shelf", "steered_noise"))
    assert (found.status, found.num, found.verified, found.attempts) == ("unverified", 2, 0, [])
    assert found.seconds["draw"] > 0
