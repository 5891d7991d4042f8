"""The failures that are shown are the worst, from different scenes where possible; a rejected draw is drawn again."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from dexnudge.errors import OutputError
from dexnudge.experiments.config import ExperimentConfig, trial_keys
from dexnudge.experiments.reproduction import failure_sections, worst_cases
from dexnudge.experiments.sampling_trial import SamplingTrial
from dexnudge.objects.builtin import builtin_object

CONFIG = ExperimentConfig(objects="builtin:test")


def test_worst_first_and_one_from_each_scene_before_a_second_of_any(four_records):
    three, one, none, failed = four_records
    found = worst_cases([(CONFIG, [three, failed, one, none])], "steered_noise")
    assert [record for _, record in found] == [none, one, three]  # a single scene: its records by their success
    shelf = replace(three, scene="shelf")
    found = worst_cases([(CONFIG, [three, one, none]), (CONFIG, [shelf])], "steered_noise")
    assert [record for _, record in found] == [none, shelf, one]


def test_only_rejected_draws_of_the_method_count(four_records):
    perfect = replace(four_records[0], success=[True] * 4)
    other = replace(four_records[2], method="unguided")
    assert worst_cases([(CONFIG, [perfect, other, four_records[3]])], "steered_noise") == []


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Three random starts in a shelf, hardly projected by chance: most of them fail."""
    objects = tmp_path_factory.mktemp("objects")
    builtin_object("phone").export(objects / "phone.obj")
    config = ExperimentConfig(objects=str(objects), scenes=("shelf",), methods=("random_start_projection",), num=3)
    (key,) = trial_keys(config)
    return config, SamplingTrial().start(config)(key)


@pytest.mark.slow  # draws and projects twice, and casts a picture
def test_the_shown_draw_is_one_of_the_records(case, tmp_path):
    _, shown = failure_sections([case], tmp_path / "pictures")
    assert np.asarray(Image.open(tmp_path / "pictures" / "failure-1.png")).std() > 10
    assert "](pictures/failure-1.png)" in shown.text
    reason, count = next(iter(case[1].rejected.items()))
    assert f"A rejected draw, {reason}: " in shown.text
    assert f"| {reason} | {count} |" in shown.table.markdown()
    margins = {f"force margin {margin:.2f}," for margin in case[1].force_margin}
    assert any(margin in shown.text for margin in margins)


def test_an_object_that_is_gone_has_no_picture(case, tmp_path):
    gone = (replace(case[0], objects="builtin:phone-nowhere"), case[1])
    _, shown = failure_sections([gone], tmp_path)
    assert shown.text == ""
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_refused(case, tmp_path):
    (tmp_path / "pictures").write_text("not a folder")
    with pytest.raises(OutputError, match="cannot write the pictures into"):
        failure_sections([case], tmp_path / "pictures")
