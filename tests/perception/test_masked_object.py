"""An object from its masks has the outline, height and place of the object that was seen."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import binary_dilation, binary_erosion

from dexnudge.errors import SceneError
from dexnudge.perception.masked_object import masked_object

TABLE = ((-0.3, -0.25, -0.02), (0.3, 0.25, 0.0))
WALL = ((0.3, -0.25, -0.02), (0.32, 0.25, 0.3))
EYES = [(-0.35, 0.25, 0.5), (-0.4, -0.2, 0.45)]
YAW = trimesh.transformations.rotation_matrix(0.4, [0, 0, 1])


@pytest.fixture(scope="module")
def phone(see, made_of):
    """150 x 70 x 12 mm, turned by 0.4 rad, seen from above with a camera's noise."""
    thing = made_of(((-0.075, -0.035, 0.0), (0.075, 0.035, 0.012))).apply_transform(YAW)
    return see(thing, made_of(TABLE, WALL), EYES, (0, 0, 0), noise=1.0, width=320, height=240, focal=300.0)


def corners_off(found, size, pose) -> float:
    """Largest distance [m] from a corner of the true box to the nearest corner of the found one."""
    box = trimesh.creation.box(size).apply_transform(pose)
    vertices = found.mesh.copy().apply_transform(found.T_world_object).vertices
    return max(np.linalg.norm(vertices - corner, axis=1).min() for corner in box.vertices)


def masked(views, change):
    return [replace(view, mask=change(view.mask)) for view in views]


def centre(z) -> np.ndarray:
    return YAW @ trimesh.transformations.translation_matrix([0, 0, z])


def test_a_phone_is_its_outline_down_to_the_table(phone):
    found = masked_object(phone)
    assert corners_off(found, (0.15, 0.07, 0.012), centre(0.006)) < 4e-3
    assert found.mesh.is_watertight
    assert found.mesh.volume > 0
    np.testing.assert_allclose(found.mesh.bounds.mean(axis=0), 0, atol=1e-9)
    bottom = found.T_world_object[2, 3] - found.mesh.extents[2] / 2
    assert bottom == pytest.approx(found.support.offset, abs=1e-4)
    assert abs(bottom) < 1e-3
    assert any("12 mm high" in each or "11 mm high" in each or "13 mm high" in each for each in found.assumed)


def test_a_coarse_mask_that_spills_over_the_table_and_misses_a_part(phone):
    """Two pixels too large: a pixel of the table is no point of the phone, as it lies at the height of the table."""
    larger = masked_object(masked(phone, lambda mask: binary_dilation(mask, iterations=2)))
    assert corners_off(larger, (0.15, 0.07, 0.012), centre(0.006)) < 8e-3
    smaller = masked_object(masked(phone, lambda mask: binary_erosion(mask, iterations=3)))
    assert corners_off(smaller, (0.15, 0.07, 0.012), centre(0.006)) < 8e-3


def test_a_part_of_the_mask_on_the_wall_is_left_out(phone):
    def wrong(mask):
        spoiled = mask.copy()
        spoiled[60:80, 150:180] = True
        return spoiled

    assert corners_off(masked_object(masked(phone, wrong)), (0.15, 0.07, 0.012), centre(0.006)) < 8e-3


def test_an_upright_box_seen_from_the_front_and_above_ends_where_its_top_does(see, made_of):
    thing = made_of(((0.05, -0.05, 0.0), (0.13, 0.06, 0.1)))
    eyes = [(-0.4, 0.15, 0.3), (-0.4, -0.15, 0.3)]
    views = see(thing, made_of(TABLE, WALL), eyes, (0.1, 0, 0.05), noise=1.0, width=320, height=240, focal=300.0)
    found = masked_object(views)
    pose = trimesh.transformations.translation_matrix([0.09, 0.005, 0.05])
    assert corners_off(found, (0.08, 0.11, 0.1), pose) < 8e-3
    front = found.mesh.copy().apply_transform(found.T_world_object).bounds[0, 0]
    assert front == pytest.approx(0.05, abs=3e-3)
    assert any("rectangle" in each for each in found.assumed)


def test_of_a_box_seen_from_the_front_alone_the_depth_is_said_to_be_assumed(see, made_of):
    thing = made_of(((0.05, -0.05, 0.0), (0.13, 0.06, 0.1)))
    views = see(thing, made_of(TABLE, WALL), [(-0.4, 0.0, 0.09)], (0.1, 0, 0.05), width=320, height=240, focal=300.0)
    found = masked_object(views)
    bounds = found.mesh.copy().apply_transform(found.T_world_object).bounds
    assert bounds[0, 0] == pytest.approx(0.05, abs=3e-3)
    assert bounds[1, 0] == pytest.approx(0.06, abs=4e-3)
    np.testing.assert_allclose(bounds[:, 1], [-0.05, 0.06], atol=6e-3)
    assert any("only its front was seen" in each for each in found.assumed)


def refusal(views) -> str:
    with pytest.raises(SceneError) as caught:
        masked_object(views)
    assert "expected" in str(caught.value)
    return str(caught.value)


def test_masks_that_cannot_be_used_are_named(phone):
    assert "no view has a mask" in refusal(masked(phone, np.zeros_like))
    assert "no view has a mask" in refusal([replace(view, mask=None) for view in phone])
    empty = [replace(view, depth=np.where(view.mask, 0.0, view.depth)) for view in phone]
    assert "no masked pixel has depth" in refusal(empty)
    few = masked(phone, lambda mask: mask & (np.cumsum(mask).reshape(mask.shape) < 40))
    assert "belong together" in refusal(few) or "no masked pixel" in refusal(few)
    elsewhere = phone[1].T_world_camera + np.array([[0, 0, 0, 1.0], [0] * 4, [0] * 4, [0] * 4])
    assert "scattered over 1." in refusal([phone[0], replace(phone[1], T_world_camera=elsewhere)])


def test_an_object_without_a_support_below_is_refused(see, made_of):
    views = see(
        made_of(((0, -0.05, 0), (0.05, 0.05, 0.1))),
        made_of(WALL),
        [(-0.4, 0.1, 0.1), (-0.4, -0.1, 0.1)],
        (0.1, 0, 0.05),
    )
    text = refusal(views)
    assert "no level plane" in text
    assert "none" in text
