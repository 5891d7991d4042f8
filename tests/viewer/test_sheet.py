import numpy as np
import pytest
import trimesh
from PIL import Image

from dexnudge.errors import InputError
from dexnudge.viewer.picture import GAP, render_array, render_sheet
from dexnudge.viewer.visual_scene import Part, VisualScene


def test_pictures_stand_row_by_row_with_titles(tmp_path):
    part = Part("object", "object", trimesh.creation.box((0.1, 0.06, 0.01)), np.eye(4))
    drawings = [VisualScene((part,), np.zeros((0, 3)), np.array([1.0, 0, 0]), title=text) for text in ("a", "b", "")]
    path = render_sheet(drawings, tmp_path / "sheet.png", columns=2, tile=(120, 90))
    with Image.open(path) as image:
        sheet = np.asarray(image)
    assert sheet.shape == (2 * 90 + GAP, 2 * 120 + GAP, 3)
    alone = render_array(drawings[2], size=(120, 90))
    np.testing.assert_array_equal(sheet[90 + GAP :, :120], alone)
    assert (sheet[:90, :120] != alone).any(axis=2)[:20, :20].any()  # the title
    assert (sheet[90 + GAP :, 120 + GAP :] == 255).all()


def test_an_empty_sheet_is_refused(tmp_path):
    with pytest.raises(InputError, match="a sheet of 0 pictures in 3 columns"):
        render_sheet([], tmp_path / "sheet.png")
