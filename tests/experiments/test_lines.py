"""Rates with failed objects in the denominator, from rows whose rates are known by hand."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from dexnudge.experiments.lines import summarise


def test_rates_by_hand(made_up_rows):
    (line,) = summarise(made_up_rows)
    assert (line.objects, line.failed, line.samples) == (4, 1, 16)
    assert line.single.value == pytest.approx(4 / 16)
    assert line.single_robust.value == pytest.approx(2 / 16)  # of a: margins 3.0 and 1.6; 2.9 did not succeed
    assert line.clean.value == pytest.approx((3 + 4 + 1) / 16)  # a draw without a depth is no clean one
    assert line.first.value == pytest.approx(1 / 4)  # only a's own first draw succeeds
    assert line.top.value == pytest.approx(2 / 4)
    assert line.top_robust.value == pytest.approx(1 / 4)
    assert line.any.value == pytest.approx(2 / 4)
    assert line.rejected == {"force": 8, "object failed": 4}
    assert sum(line.rejected.values()) + 4 == line.samples
    assert line.seconds == {"load": 9.0, "prepare": 0.5, "draw": 1.0, "verify": 0.5}
    assert line.verified_per_second.value == pytest.approx(4 / 6.0)
    assert line.top.low <= line.top.value <= line.top.high


def test_depths_and_margins_are_those_of_every_sampled_draw(made_up_rows):
    (line,) = summarise(made_up_rows)
    depths = [0.0, 0.0, 0.5, 2.0, 0.2, 0.3, 0.4, 0.6, 1.5, 4.0, 0.1]
    assert line.depth_mm.value == pytest.approx((0.25 + 0.35 + 1.5) / 3)
    assert line.depth_95_mm == pytest.approx(np.percentile(depths, 95))
    assert line.margin.value == pytest.approx((2.25 + 0.5 + 0.5) / 3)
    assert line.top_margin.value == pytest.approx((3.0 + 1.2 + 0.5) / 3)


def test_spreads_are_means_over_the_objects_that_have_one(made_up_rows):
    a, b, *others = made_up_rows
    assert summarise(made_up_rows)[0].joint_diversity is None
    spread = [
        replace(a, joint_diversity=0.2, contact_diversity=0.5),
        replace(b, joint_diversity=0.4, contact_diversity=0.9),
    ]
    (line,) = summarise([*spread, *others])
    assert line.joint_diversity.value == pytest.approx(0.3)
    assert line.contact_diversity.value == pytest.approx(0.7)
    assert line.spread_objects == 2


def test_the_top_of_eight_is_the_mean_over_every_choice_of_eight(made_up_rows):
    a = made_up_rows[0]
    success = [True] * 3 + [False] * 7
    margins = [2.0, 1.6, 1.1] + [0.5] * 7
    many = replace(a, num=10, success=success, force_margin=margins, penetration_mm=[0.0] * 10, own_rank=[*range(10)])
    failed = replace(made_up_rows[3], num=10)
    (line,) = summarise([many, failed])
    assert list(line.best_of) == [8]  # there are no 32 draws to choose from
    top = [min(choice) for choice in combinations(range(10), 8)]  # rows are ranked, so the top is the first of a choice
    assert line.best_of[8].value == pytest.approx(np.mean([success[place] for place in top]) / 2)
    robust = [success[place] and margins[place] >= 1.5 for place in top]
    assert line.best_of_robust[8].value == pytest.approx(np.mean(robust) / 2)
    assert summarise(made_up_rows)[0].best_of == {}


def test_each_scene_and_method_has_its_line(made_up_rows):
    both = [*made_up_rows, replace(made_up_rows[0], method="unguided")]
    assert [(line.scene, line.method, line.objects) for line in summarise(both)] == [
        ("table", "steered_noise", 4),
        ("table", "unguided", 1),
    ]


def test_a_method_whose_every_object_failed_has_a_line_of_zeros(made_up_rows):
    (line,) = summarise([made_up_rows[3]])
    assert (line.objects, line.failed, line.samples) == (1, 1, 4)
    assert line.single.value == line.any.value == line.verified_per_second.value == 0.0
    assert line.depth_mm is line.margin is line.top_margin is line.joint_diversity is None
    assert line.rejected == {"object failed": 4}
