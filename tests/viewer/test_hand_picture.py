"""The picture of a hand, on hands whose every part is known."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from dexnudge.viewer.hand_view import ARROW_COLOUR, DIGIT_COLOURS, hand_views, palm_in_view
from dexnudge.viewer.robot_pictures import hand_picture

TILE, GAP = (168, 180), 6  # pixels
HEADING = 23  # pixels
POSES, SIDES = ("rest", "open", "closed"), ("front", "side")


def tiles(picture):
    """The six pictures by (side, pose), their titles left out."""
    found = {}
    for row, side in enumerate(SIDES):
        for column, pose in enumerate(POSES):
            top, left = HEADING + row * (TILE[1] + GAP), column * (TILE[0] + GAP)
            found[side, pose] = picture[top + 20 : top + TILE[1], left : left + TILE[0]].astype(float)
    return found


def coloured(tile, colour):
    """Pixels (row, column) whose hue and saturation are those of a colour in whatever light."""
    pixels = tile / np.maximum(np.linalg.norm(tile, axis=2, keepdims=True), 1.0)
    return np.argwhere(pixels @ (np.asarray(colour) / np.linalg.norm(colour)) > 0.985)


def way_of_arrow(tile):
    """From the shaft's end to the head, in pixels (right, up): the head is the thick end."""
    pixels = coloured(tile, ARROW_COLOUR)[:, ::-1] * [1, -1]
    assert len(pixels) > 60
    middle = pixels.mean(axis=0)
    along = np.linalg.svd(pixels - middle, full_matrices=False)[2][0]
    place = (pixels - middle) @ along
    ends = place.min(), place.max()
    heavy = np.histogram(place, bins=4)[0]
    return (ends[1] - ends[0]) * along * (1 if heavy[-2:].sum() > heavy[:2].sum() else -1)


@pytest.fixture(scope="module")
def picture(toy_hand):
    return hand_picture(toy_hand(), tile=TILE)


def test_the_arrow_points_to_where_the_palm_faces(picture):
    shown = tiles(picture)
    for pose in POSES:
        right, up = way_of_arrow(shown["side", pose])
        assert right < -40
        assert abs(up) < 0.15 * abs(right)
        right, up = way_of_arrow(shown["front", pose])  # towards the viewer, who looks from above and from the right
        assert right < -10
        assert up < -5


def test_the_arrow_starts_on_the_palm_and_leaves_it(toy_hand):
    hand = toy_hand()
    (view,) = hand_views(hand, [np.zeros(8)])
    (arrow,) = view.with_role("arrow")
    T_palm_view = np.linalg.inv(palm_in_view(hand))
    depth = trimesh.transform_points(arrow.mesh.vertices, T_palm_view) @ [0.0, -1.0, 0.0]
    assert depth.min() == pytest.approx(0.01, abs=1e-6)  # half the palm's thickness
    assert depth.max() > 0.05


def test_poses_differ_and_digits_have_the_colours_of_the_legend(picture):
    shown = tiles(picture)
    for side in SIDES:
        for one, other in (("rest", "open"), ("open", "closed"), ("closed", "rest")):
            assert (np.abs(shown[side, one] - shown[side, other]).max(axis=2) > 40).sum() > 200
    places = [coloured(shown["front", "rest"], colour).mean(axis=0) for colour in DIGIT_COLOURS[:4]]
    index, middle, ring, thumb = (place[1] for place in places)
    assert ring < middle < index < thumb
    assert places[3][0] > places[0][0] + 15  # the thumb's tip is lower
    legend = picture[HEADING + 2 * TILE[1] + GAP :].reshape(-1, 3)
    for colour in (*DIGIT_COLOURS[:4], ARROW_COLOUR):
        assert (legend == np.rint(255 * np.asarray(colour))).all(axis=1).sum() > 40


def test_a_left_hand_has_its_thumb_on_the_other_side(toy_hand):
    shown = tiles(hand_picture(toy_hand(mirrored=True), tile=TILE))
    thumb, index = (coloured(shown["front", "rest"], DIGIT_COLOURS[digit]).mean(axis=0)[1] for digit in (3, 0))
    assert thumb < index - 15
    assert way_of_arrow(shown["side", "closed"])[0] < -40


@pytest.mark.parametrize("size", [0.02, 50.0])
def test_tiny_and_huge_hands_in_any_frame_are_seen_alike(size, toy_hand):
    turn = trimesh.transformations.euler_matrix(0.7, -2.1, 1.3)
    bent = [np.linspace(0.1, 0.8, 8)]
    (one,), (other,) = hand_views(toy_hand(), bent), hand_views(toy_hand(size=size, T_palm_toy=turn), bent)
    for part, same in zip(one.parts, other.parts, strict=True):
        near = (
            0.01 if part.role == "arrow" else 1e-6
        )  # [m] of a hand of 0.2 m; the arrow starts about the palm's middle
        np.testing.assert_allclose(same.vertices_in_world(), part.vertices_in_world(), atol=near)
        assert same.colour == part.colour
    assert one.vertices("link", "fingertip")[:, 2].max() > 0.1  # fingers up


def test_a_gripper_stands_upright_with_its_jaws_apart(toy_gripper):
    shown = tiles(hand_picture(toy_gripper, tile=TILE))
    for pose in ("rest", "open"):
        right, up = way_of_arrow(shown["front", pose])
        assert up > 40
        assert abs(right) < 0.15 * up
    width = {
        pose: abs(np.subtract(*(coloured(shown["front", pose], colour)[:, 1].mean() for colour in DIGIT_COLOURS[:2])))
        for pose in POSES
    }
    assert width["open"] > width["closed"] + 5


def test_the_same_hand_gives_the_same_picture(picture, toy_hand):
    np.testing.assert_array_equal(hand_picture(toy_hand(), tile=TILE), picture)


def test_the_file_is_wide_and_long_names_are_cut(toy_gripper):
    hand = replace(toy_gripper, name="a gripper of a long name " * 20)
    shown = hand_picture(hand)
    assert shown.shape[1] >= 1500
    heading = shown[:40]
    assert (heading[:, -20:] == 255).all()
    assert (heading < 128).any()
