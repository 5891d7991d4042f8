"""Figures of sampling, with failed objects in the denominator, from records whose figures are known by hand."""

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from dexnudge.experiments.comparisons import EQUAL_TIME, equal_time, paper_table
from dexnudge.experiments.metrics import measure
from dexnudge.experiments.sampling_records import METRICS, measure_disturbed
from dexnudge.experiments.sampling_trial import contact_diversity, joint_diversity
from dexnudge.experiments.tables import metric_table
from dexnudge.mechanics.contacts import HandContacts


def figures(records):
    (row,) = measure(records, METRICS)
    return row


def test_rates(four_records):
    row = figures(four_records)
    assert (row["objects"], row["failed"], row["draws"]) == (4, 1, 16)
    assert row["single"].value == pytest.approx(4 / 16)
    assert row["single_robust"].value == pytest.approx(2 / 16)  # of a: margins 3.0 and 1.6; 2.9 did not succeed
    assert row["clean"].value == pytest.approx((3 + 4 + 1) / 16)  # a draw without a depth is no clean one
    assert row["first"].value == pytest.approx(1 / 4)  # only a's own first draw succeeds
    assert row["top"].value == row["any"].value == pytest.approx(2 / 4)
    assert row["top_robust"].value == pytest.approx(1 / 4)
    assert row["rejected"] == {"force": 8, "object failed": 4}
    assert sum(row["rejected"].values()) + 4 == row["draws"]
    assert row["seconds"] == {"load": 9.0, "prepare": 0.5, "draw": 1.0, "verify": 0.5}
    assert row["verified_per_second"].value == pytest.approx(4 / 6.0)
    assert row["top"].low <= row["top"].value <= row["top"].high
    assert row["top_of_8"] is None  # there are no 8 draws


def test_depths_and_margins_are_those_of_every_draw(four_records):
    row = figures(four_records)
    depths = [0.0, 0.0, 0.5, 2.0, 0.2, 0.3, 0.4, 0.6, 1.5, 4.0, 0.1]
    assert row["depth_mm"].value == pytest.approx((0.25 + 0.35 + 1.5) / 3)
    assert row["depth_95_mm"] == pytest.approx(np.percentile(depths, 95))
    assert row["margin"].value == pytest.approx((2.25 + 0.5 + 0.5) / 3)
    assert row["top_margin"].value == pytest.approx((3.0 + 1.2 + 0.5) / 3)


def test_diversities_are_means_over_the_objects_that_have_one(four_records):
    a, b, *others = four_records
    assert figures(four_records)["joint_diversity"] is None
    a, b = (
        replace(a, joint_diversity=0.2, contact_diversity=0.5),
        replace(b, joint_diversity=0.4, contact_diversity=0.9),
    )
    row = figures([a, b, *others])
    assert row["joint_diversity"].value == pytest.approx(0.3)
    assert row["contact_diversity"].value == pytest.approx(0.7)
    assert row["diverse_objects"] == 2


def test_the_top_of_eight_is_the_mean_over_every_choice_of_eight(sampled, four_records):
    success = [True] * 3 + [False] * 7
    many = sampled("many", success, [2.0] * 10)
    row = figures([many, replace(four_records[3], num=10)])
    top = [success[min(choice)] for choice in combinations(range(10), 8)]
    assert row["top_of_8"].value == pytest.approx(np.mean(top) / 2)
    assert row["top_of_32"] is None


def test_each_scene_and_method_has_its_figures(four_records):
    rows = measure([*four_records, replace(four_records[0], method="unguided")], METRICS)
    assert [(row["scene"], row["method"], row["objects"]) for row in rows] == [
        ("table", "steered_noise", 4),
        ("table", "unguided", 1),
    ]


def test_a_method_whose_every_object_failed_has_zeros(four_records):
    row = figures([four_records[3]])
    assert (row["objects"], row["failed"], row["draws"]) == (1, 1, 4)
    assert row["single"].value == row["any"].value == row["verified_per_second"].value == 0.0
    assert row["depth_mm"] is row["margin"] is row["top_margin"] is row["joint_diversity"] is None
    assert row["rejected"] == {"object failed": 4}


def test_at_other_frictions_and_masses_the_top_is_the_one_ranked_first_as_drawn(four_records):
    flags = [[False, True, True, False], [True, False, False, False], [False] * 4]
    records = [
        replace(each, swept={"mass x 2": ok}) for each, ok in zip(four_records[:3], flags, strict=True)
    ] + four_records[3:]
    drawn, heavy = measure_disturbed(records)
    assert (drawn["setting"], heavy["setting"]) == ("as drawn", "mass x 2")
    for row, expected in ((drawn, (4 / 16, 2 / 4, 2 / 4)), (heavy, (3 / 16, 1 / 4, 2 / 4))):
        assert (row["single"].value, row["top"].value, row["any"].value) == pytest.approx(expected)
    assert measure_disturbed(four_records) == []


class TestEqualTime:
    """Ours verifies 3, 1, 0 and none of the failed object, in 1.5 s each; the baseline 1, 1, 1 in 0.75, 3, 3 s."""

    @pytest.fixture
    def records(self, four_records):
        def baseline(record, seconds):
            spent = {"load": 1.0, "prepare": 0.5, "draw": seconds}
            return replace(
                record,
                method="plain",
                success=[True, False, False, False],
                verified=1,
                seconds=spent,
                contact_diversity=seconds,
            )

        a, b, c, failed = four_records
        a = replace(a, joint_diversity=0.2, contact_diversity=0.5)
        return [a, baseline(a, 0.75), b, baseline(b, 3.0), c, baseline(c, 3.0), failed, replace(failed, method="plain")]

    def test_every_count_is_scaled_to_the_same_time(self, records):
        ours, plain = equal_time(records, "steered_noise", "plain")
        assert ours["seconds"].value == plain["seconds"].value == pytest.approx(1.5 * 3 / 4)
        assert ours["verified"].value == pytest.approx(4 / 4)
        assert plain["verified"].value == pytest.approx((1.5 / 0.75 + 1.5 / 3 + 1.5 / 3) / 4)
        swapped = equal_time(records, "plain", "steered_noise")[0]  # ours in the time of the baseline
        assert swapped["verified"].value == pytest.approx((3 * 0.75 / 1.5 + 1 * 3.0 / 1.5) / 4)
        assert equal_time(records, "steered_noise", "unguided") == []

    def test_rates_are_ratios_of_sums_and_loading_never_counts(self, records):
        found, itself = equal_time(records, "steered_noise", "plain")
        ours, plain = 4 / (3 * 2.0), 3 / (1.25 + 3.5 + 3.5)
        assert found["per_second"].value == pytest.approx(ours)
        assert itself["per_second"].value == pytest.approx(plain)
        assert found["prepared_per_second"].value == pytest.approx(4 / 4.5)
        assert found["speed_up"].value == pytest.approx(ours / plain)
        assert found["prepared_speed_up"].value == pytest.approx((4 / 4.5) / (3 / 6.75))
        assert vars(itself["speed_up"]) == pytest.approx({"value": 1.0, "low": 1.0, "high": 1.0})
        assert found["contact_diversity"].value == 0.5  # of the first object alone

    def test_a_baseline_that_verifies_nothing_is_infinitely_slower(self, records):
        nothing = [replace(each, verified=0) if each.method == "plain" else each for each in records]
        found, itself = equal_time(nothing, "steered_noise", "plain")
        assert itself["verified"].value == 0.0
        assert found["speed_up"].value == np.inf
        assert "| table | steered_noise | 1.0 (" in metric_table([found], EQUAL_TIME).markdown()


def test_the_papers_numbers_stand_beside_ours(four_records):
    rows = measure([*four_records, *(replace(each, method="guidance_only") for each in four_records)], METRICS)
    first, second = (paper_table({"with the forearm": rows}, number).rows for number in (1, 2))
    assert [row[:5] for row in first] == [
        ["table", "steered_noise", "with the forearm", 73.2, rows[0]["single"].percent()]
    ]
    assert [row[:5] for row in second] == [
        ["table", "guidance_only", "with the forearm", 26.8, 0.0],
        ["table", "steered_noise", "with the forearm", 100.0, 73.2],
    ]
    new = [{**row, "scene": "slot"} for row in rows]
    assert paper_table({"x": new}, 1).rows[0][3] == ""


def test_joint_diversity_leaves_root_poses_out():
    q = np.random.default_rng(0).normal(size=(5, 13))
    scales = np.array([1.0, 1.0, 1.0, 0.05])  # the last joint slides
    expected = np.mean([np.std(q[:, 9 + joint], ddof=1) / scales[joint] for joint in range(4)])
    assert joint_diversity(q, scales) == pytest.approx(expected)
    q[:, 9:] = 0.3
    assert joint_diversity(q, scales) == 0.0
    assert joint_diversity(q[:1], scales) is joint_diversity(q[:0], scales) is None


def contacts(*pairs):
    link, points = zip(*pairs, strict=True)
    return HandContacts(points=np.array(points), normals=np.tile([0.0, 0.0, 1.0], (len(link), 1)), link=np.array(link))


def test_contact_diversity_counts_each_fingertip_once_in_half_lengths(boxy_hand, block_scene):
    tip_a, tip_b, palm = (boxy_hand.link_names.index(name) for name in ("tip_a", "tip_b", "palm"))
    first = contacts((tip_a, [0.02, 0.0, 0.02]), (tip_a, [0.04, 0.0, 0.02]), (palm, [9.0, 9.0, 9.0]))
    second = contacts((tip_a, [-0.03, 0.0, 0.02]), (tip_b, [0.0, 0.04, 0.02]))
    places = [(0.03, 0.0, 0.02), (-0.03, 0.0, 0.02), (0.0, 0.04, 0.02)]
    mean = [sum(axis) / 3 for axis in zip(*places, strict=True)]
    expected = sum(math.dist(place, mean) for place in places) / 3 / 0.08  # the block is 160 mm long
    assert contact_diversity(boxy_hand, block_scene, [first, second]) == pytest.approx(expected)
    assert contact_diversity(boxy_hand, block_scene, []) is None
    only = contacts((palm, [0.0, 0.0, 0.0]), (tip_a, [0.0, 0.0, 0.0]), (tip_a, [0.1, 0.0, 0.0]))
    assert contact_diversity(boxy_hand, block_scene, [only]) is None
