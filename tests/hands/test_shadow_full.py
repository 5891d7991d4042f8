"""The full hand: names, order, ranges and couplings. Its kinematics is compared with MuJoCo's elsewhere."""

import numpy as np

from dexnudge.hands.registry import load_hand


def test_joints_in_shadows_naming(full):
    fingers = [f"{finger}J{number}" for finger in ("FF", "MF", "RF") for number in (4, 3, 2, 1)]
    little = [f"LFJ{number}" for number in (5, 4, 3, 2, 1)]
    thumb = [f"THJ{number}" for number in (5, 4, 3, 2, 1)]
    assert list(full.joint_names) == ["WRJ2", "WRJ1", *fingers, *little, *thumb]
    assert full.couplings == tuple((f"{finger}J1", f"{finger}J2") for finger in ("FF", "MF", "RF", "LF"))


def test_ranges_are_the_packages(full):
    ranges = dict(zip(full.joint_names, zip(full.lower, full.upper, strict=True), strict=True))
    assert ranges["WRJ2"] == (-0.489, 0.14)
    assert ranges["WRJ1"] == (-0.698, 0.489)
    assert ranges["LFJ5"] == (0.0, 0.785)
    assert ranges["THJ1"] == (-1.571, 0.0)


def test_palm_is_the_root_and_the_arm_hangs_from_it(full):
    assert full.link_names[:3] == ("palm", "wrist", "forearm")
    assert full.link_parent[:3].tolist() == [-1, 0, 1]
    assert full.base_link == "forearm"
    assert [full.digit_of_link[link] for link in ("wrist", "forearm", "lfmetacarpal", "thhub")] == [
        None,
        None,
        "LF",
        "TH",
    ]


def test_without_base_the_wrist_goes_too(full):
    bare = load_hand("shadow_full", base=False)
    assert bare.joint_names == full.joint_names[2:]
    assert bare.link_names == ("palm", *full.link_names[3:])


def test_same_finger_geometry_as_the_lite(full, lite):
    for link in ("palm", "mfproximal", "rfdistal"):
        ours, theirs = (hand.link_meshes[hand.link_names.index(link)] for hand in (full, lite))
        np.testing.assert_allclose(ours.bounds, theirs.bounds, atol=1e-6 if link != "rfdistal" else 1.1e-3)
        np.testing.assert_allclose(ours.area, theirs.area, rtol=1e-3)
