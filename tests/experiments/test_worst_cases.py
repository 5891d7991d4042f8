"""The failures that are shown are the worst, from different scenes where possible."""

from dataclasses import replace

import pytest

from dexnudge.experiments.reproduction_parts import ReproductionConfig, parts
from dexnudge.experiments.worst_cases import REASONS, reason_table, worst_cases
from dexnudge.verification.criteria import default_criteria


@pytest.fixture
def part():
    return parts(ReproductionConfig())[0]


def test_worst_first_and_one_from_each_scene_before_a_second_of_any(part, made_up_rows):
    three, one, none, failed = made_up_rows
    found = worst_cases([(part, [three, failed, one, none])], "steered_noise")
    assert [case.row for case in found] == [none, one, three]  # a single scene: its rows by their success
    shelf = replace(three, scene="shelf")
    found = worst_cases([(part, [three, one, none]), (part, [shelf])], "steered_noise")
    assert [case.row for case in found] == [none, shelf, one]


def test_only_rejected_draws_of_the_method_count(part, made_up_rows):
    perfect = replace(made_up_rows[0], success=[True] * 4)
    other = replace(made_up_rows[2], method="unguided")
    assert worst_cases([(part, [perfect, other, made_up_rows[3]])], "steered_noise") == []


def test_every_reason_of_the_judge_has_its_meaning(made_up_rows):
    assert {criterion.name for criterion in default_criteria()} == set(REASONS)
    row = replace(made_up_rows[0], rejected={"force_margin": 3, "contact": 1})
    assert f"| force_margin | {REASONS['force_margin']} | 3 |" in reason_table(row)
    assert f"| contact | {REASONS['contact']} | 1 |" in reason_table(row)
