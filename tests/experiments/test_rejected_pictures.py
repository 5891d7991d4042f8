"""A rejected draw is drawn again from its row and shown."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from dexnudge.errors import OutputError
from dexnudge.experiments.config import ExperimentConfig, all_tasks
from dexnudge.experiments.rejected_pictures import picture_rejected
from dexnudge.experiments.reproduction_parts import Part
from dexnudge.experiments.row_maker import RowMaker
from dexnudge.experiments.worst_cases import WorstCase
from dexnudge.objects.builtin import builtin_object


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Three random starts in a shelf, hardly projected by chance: most of them fail."""
    objects = tmp_path_factory.mktemp("objects")
    builtin_object("phone").export(objects / "phone.obj")
    config = ExperimentConfig(objects=str(objects), scenes=("shelf",), methods=("random_start_projection",), num=3)
    (task,) = all_tasks(config)
    return WorstCase(Part("hard", "Hard scenes", config), RowMaker(config)(task))


@pytest.mark.slow  # draws and projects twice, and casts a picture
def test_the_shown_draw_is_one_of_the_rows(case, tmp_path):
    (shown,) = picture_rejected([case], tmp_path / "plots")
    assert shown.picture == tmp_path / "plots" / "failure-1.png"
    assert np.asarray(Image.open(shown.picture)).std() > 10
    assert shown.reason == next(iter(case.row.rejected))
    deepest = max(shown.penetration_environment, shown.penetration_object, shown.penetration_self)
    place = case.row.penetration_mm.index(pytest.approx(1e3 * deepest, abs=1e-3))
    assert not case.row.success[place]
    if shown.reason in ("penetration environment", "penetration object"):
        assert shown.deepest_link
    assert shown.force_margin == pytest.approx(case.row.force_margin[place], abs=1e-3)


def test_an_object_that_is_gone_has_no_picture(case, tmp_path):
    gone = replace(case, part=replace(case.part, config=replace(case.part.config, objects="builtin:phone-nowhere")))
    assert picture_rejected([gone], tmp_path) == [None]
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "plots").write_text("not a folder")
    with pytest.raises(OutputError, match="cannot write the pictures into"):
        picture_rejected([], tmp_path / "plots")
