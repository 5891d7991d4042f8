"""The Lite against the published table, entry by entry, and its thumb against the full hand of the package."""

import numpy as np
import pytest
import torch

from dexnudge.hands.registry import load_hand

RANGES = {  # [deg]
    **{f"{finger}J{number}": (-20, 20) if number == 4 else (-15, 90) if number == 3 else (0, 90)
       for finger in ("FF", "MF", "RF") for number in (4, 3, 2, 1)},
    "THJ5": (-60, 60), "THJ4": (0, 70), "THJ2": (-40, 40), "THJ1": (-15, 90),
}  # fmt: skip
HALF = np.sqrt(0.5)


def pose(hand, link, **angles):
    """T_palm_link with the given joint angles [rad], all others zero."""
    q = torch.zeros(1, 9 + hand.num_joints, dtype=torch.float64)
    q[0, 3] = q[0, 7] = 1.0
    for name, angle in angles.items():
        q[0, 9 + hand.joint_names.index(name)] = angle
    return hand.forward_kinematics(q)[0, hand.link_names.index(link)].numpy()


def test_joint_order_and_ranges(lite):
    assert list(lite.joint_names) == list(RANGES)
    np.testing.assert_allclose(np.degrees(lite.lower), [low for low, _ in RANGES.values()])
    np.testing.assert_allclose(np.degrees(lite.upper), [high for _, high in RANGES.values()])


def test_links_digits_and_couplings(lite):
    assert lite.link_names[0] == "palm"
    assert lite.link_parent[0] == -1
    assert (lite.link_parent[1:] < np.arange(1, len(lite.link_names))).all()
    assert lite.digit_of_link["palm"] is None
    assert lite.digit_of_link["base"] is None
    assert lite.digit_of_link["mfknuckle"] == "MF"
    assert lite.digit_of_link["thbase"] == "TH"
    assert lite.fingertip_links == ("ffdistal", "mfdistal", "rfdistal", "thdistal")
    assert lite.couplings == (("FFJ1", "FFJ2"), ("MFJ1", "MFJ2"), ("RFJ1", "RFJ2"))
    np.testing.assert_array_equal(lite.palm_normal, (0, -1, 0))


@pytest.mark.parametrize(("finger", "x", "z"), [("ff", 0.033, 0.095), ("mf", 0.011, 0.099), ("rf", -0.011, 0.095)])
def test_fingers_stand_straight_at_zero(lite, finger, x, z):
    for link, height in (("knuckle", 0), ("proximal", 0), ("middle", 0.045), ("distal", 0.070)):
        expected = np.eye(4)
        expected[:3, 3] = (x, 0, z + height)
        np.testing.assert_allclose(pose(lite, finger + link), expected, atol=1e-12)


@pytest.mark.parametrize(("finger", "axis"), [("FF", (0, -1, 0)), ("MF", (0, -1, 0)), ("RF", (0, 1, 0))])
def test_finger_axes(lite, finger, axis):
    np.testing.assert_allclose(turn(lite, f"{finger.lower()}knuckle", f"{finger}J4"), axis, atol=1e-12)
    for link, number in (("proximal", 3), ("middle", 2), ("distal", 1)):
        np.testing.assert_allclose(turn(lite, finger.lower() + link, f"{finger}J{number}"), (1, 0, 0), atol=1e-12)


def turn(hand, link, joint):
    """Axis in the palm frame about which a small positive angle of `joint` turns the link."""
    step = 1e-6
    difference = (pose(hand, link, **{joint: step}) - pose(hand, link, **{joint: -step}))[:3, :3] / (2 * step)
    skew = difference @ pose(hand, link)[:3, :3].T
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def test_flexing_a_finger_moves_its_tip_to_the_palm_side(lite):
    tip = np.array([0, 0, 0.026, 1])
    moved = pose(lite, "ffdistal", FFJ3=0.5, FFJ2=0.5, FFJ1=0.5) @ tip - pose(lite, "ffdistal") @ tip
    assert moved[:3] @ lite.palm_normal > 0.03


def test_thumb_axes_and_zero_pose(lite):
    # rpy (-45, 0, -90) degrees: R = Rz(-90) Rx(-45), so the thumb's x is the palm's -y, its z points to +x and +z.
    base = pose(lite, "thbase")
    np.testing.assert_allclose(base[:3, :3], [[0, HALF, HALF], [-1, 0, 0], [0, -HALF, HALF]], atol=1e-12)
    np.testing.assert_allclose(base[:3, 3], (0.034, -0.00858, 0.029), atol=1e-12)
    along = np.array((HALF, 0, HALF))
    np.testing.assert_allclose(pose(lite, "thmiddle")[:3, 3], base[:3, 3] + 0.038 * along, atol=1e-12)
    np.testing.assert_allclose(pose(lite, "thdistal")[:3, 3], base[:3, 3] + 0.070 * along, atol=1e-12)
    np.testing.assert_allclose(turn(lite, "thdistal", "THJ5"), -along, atol=1e-12)
    np.testing.assert_allclose(turn(lite, "thdistal", "THJ4"), (HALF, 0, -HALF), atol=1e-12)
    np.testing.assert_allclose(turn(lite, "thdistal", "THJ2"), (0, -1, 0), atol=1e-12)
    np.testing.assert_allclose(turn(lite, "thdistal", "THJ1"), (0, -1, 0), atol=1e-12)


def test_thumb_meshes_stand_as_in_the_package_model(lite, full):
    # The two descriptions place the thumb's base 0.4 mm apart; a mesh turned wrongly about z would be off by millimetres.
    for link in ("thproximal", "thmiddle", "thdistal"):
        here, there = (
            hand.link_meshes[hand.link_names.index(link)].vertices @ pose(hand, link)[:3, :3].T
            + pose(hand, link)[:3, 3]
            for hand in (lite, full)
        )
        np.testing.assert_allclose(np.sort(here, axis=0), np.sort(there, axis=0), atol=6e-4)


def test_base_box_behind_the_palm(lite):
    mesh = lite.link_meshes[lite.link_names.index("base")]
    corners = mesh.vertices @ pose(lite, "base")[:3, :3].T + pose(lite, "base")[:3, 3]
    # Back into the base's frame: T_base_palm turns by -40 degrees about x and moves by (0, -0.015, 0.149).
    cosine, sine = np.cos(np.radians(40)), np.sin(np.radians(40))
    in_base = corners @ np.array([[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]]).T + (0, -0.015, 0.149)
    np.testing.assert_allclose(in_base.min(axis=0), (-0.060, -0.0545, 0.0), atol=1e-12)
    np.testing.assert_allclose(in_base.max(axis=0), (0.060, 0.0545, 0.130), atol=1e-12)


def test_without_base(lite):
    bare = load_hand("shadow_lite", base=False)
    assert bare.link_names == lite.link_names[:-1]
    assert bare.base_link is None
    assert bare.joint_names == lite.joint_names
