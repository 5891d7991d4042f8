"""Scenes in which nothing can succeed: exit 2 before drawing where the scene itself says so; otherwise exit 3, every draw
written and counted, and the reason said."""

import json

import numpy as np
import pytest
import trimesh

from dexnudge.results.folder import nothing_verified

NUM = 4


@pytest.fixture
def sample(dexnudge, tmp_path):
    """Draws in surroundings of boxes for a slab of 150 x 70 x 10 mm at the origin, motion +x: (stdout, summary, success)."""

    def draw(*boxes, options=(), refused=False):
        trimesh.creation.box((0.15, 0.07, 0.010)).export(tmp_path / "object.obj")
        walls = [trimesh.creation.box(bounds=bounds) for bounds in boxes]
        trimesh.util.concatenate(walls).export(tmp_path / "environment.obj")
        (tmp_path / "pose.json").write_text(json.dumps({"position": [0, 0, 0], "quaternion_wxyz": [1, 0, 0, 0]}))
        own = ["--environment", tmp_path / "environment.obj", "--object-pose", tmp_path / "pose.json"]
        outcome = dexnudge(
            *("sample", tmp_path / "object.obj", *own, "--motion", 1, 0, 0, "--num", NUM),
            *("--method", "random_start_projection", *options, "--out", tmp_path / "out"),
        )
        if refused:
            assert (outcome.code, outcome.out) == (2, "")
            assert not (tmp_path / "out").exists()
            return outcome.err
        assert outcome.code == 3, outcome.err
        with np.load(tmp_path / "out" / "configurations.npz") as archive:
            success = archive["success"]
        return outcome.out, json.loads((tmp_path / "out" / "summary.json").read_text()), success

    return draw


FLOOR = ((-0.5, -0.5, -0.055), (0.5, 0.5, -0.005))


def assert_nothing(summary, success):
    assert (summary["drawn"], summary["verified"], summary["best_force_margin"]) == (NUM, 0, None)
    assert sum(summary["rejected"].values()) == NUM
    assert success.tolist() == [False] * NUM


def test_an_object_wedged_against_a_wall(sample):
    said = sample(FLOOR, ((0.075, -0.5, -0.005), (0.1, 0.5, 0.02)), refused=True)
    assert said.startswith("dexnudge: the way along (1.00, 0.00, 0.00) is blocked by what it touches at (0.075, ")
    assert "choose another --motion: (0.00, 1.00, 0.00), " in said


def test_an_object_that_is_walled_in(sample):
    """The cell leaves 2 mm around the object: no finger fits in, so the hand would always stand in something."""
    low, high = np.array([-0.077, -0.037, -0.005]), np.array([0.077, 0.037, 0.007])
    walls = []
    for axis in range(3):
        for inner, sign in ((low[axis], -1), (high[axis], 1)):
            bounds = np.array([low - 0.05, high + 0.05])
            bounds[:, axis] = sorted([inner, inner + 0.05 * sign])
            walls.append(bounds)
    way, fingers = sample(*walls, refused=True).splitlines()
    assert "is blocked after 2 mm by something " in way
    assert fingers.startswith("no finger fits anywhere: the largest gap around the object is 2.0 mm, ")


@pytest.mark.slow
def test_a_hand_too_slippery_and_weak_to_move_anything(sample):
    out, summary, success = sample(
        FLOOR, options=("--friction-hand", 0, "--friction-environment", 1, "--max-normal-force", 0.01)
    )
    assert_nothing(summary, success)
    assert "force_margin" in summary["rejected"]
    assert "of them fail" in out


REASONS = {"force_margin": "no forces", "penetration_self": "crossed", "motion_not_blocked": "something is in the way"}


def test_the_most_frequent_reason_is_the_one_that_is_said():
    summary = {"drawn": 9, "rejected": {"force_margin": 5, "penetration_self": 4}, "reasons": REASONS}
    assert nothing_verified(summary) == "none of 9 draws is verified; 5 of them fail 'force_margin': no forces"


def test_a_blocked_motion_is_said_even_where_most_draws_failed_for_something_else():
    rejected = {"penetration_self": 4, "motion_not_blocked": 1}
    said = nothing_verified({"drawn": 5, "rejected": rejected, "reasons": REASONS})
    assert said == (
        "none of 5 draws is verified; 4 of them fail 'penetration_self': crossed; and something is in the way"
    )


def test_a_reason_without_a_sentence_ends_with_its_name():
    said = nothing_verified({"drawn": 5, "rejected": {"mine": 5}, "reasons": {"mine": " "}})
    assert said == "none of 5 draws is verified; 5 of them fail 'mine'"
