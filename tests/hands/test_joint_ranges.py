"""Ranges of joints: a follower keeps its own limits, and stand-ins for "no limit" are told from degrees."""

import numpy as np
import pytest

from dexnudge.errors import HandError
from dexnudge.hands.registry import load_hand

FOLLOWER = '<mimic joint="near" multiplier="0.8" offset="-0.2"/>'
YAML = "palm: palm\nfingertips: {F: pad, T: thumbtip}\npalm_normal: [0, -2, 0]\n"


def follower(limits: str, multiplier: float = 0.8, offset: float = -0.2) -> str:
    return f'<limit {limits}/><mimic joint="near" multiplier="{multiplier}" offset="{offset}"/>'


def changed(write_hand, old: str, new: str):
    path = write_hand(config=YAML)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    return path


def message(path) -> str:
    with pytest.raises(HandError) as caught:
        load_hand(path)
    return str(caught.value)


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ('lower="-0.1" upper="0.5"', (0.125, 0.875)),  # (l + 0.2) / 0.8
        ('lower="-9e15" upper="9e15"', (0.0, 1.2)),
        ('lower="0" upper="0" effort="1"', (0.0, 1.2)),
        ('lower="-3" upper="0.7599999"', (0.0, 1.2)),  # printed with seven digits
    ],
)
def test_a_leader_goes_as_far_as_its_follower_may(write_hand, stated, expected):
    hand = load_hand(changed(write_hand, FOLLOWER, follower(stated)))
    index = hand.joint_names.index("near")
    np.testing.assert_allclose([hand.lower[index], hand.upper[index]], expected, rtol=0, atol=1e-12)
    assert any("its followers keep their own limits (far, middle)" in note for note in hand.notes) == (
        expected != (0.0, 1.2)
    )


def test_followers_of_followers_and_those_that_run_backwards_count(write_hand):
    # far = -0.5 middle + 0.1 = -0.4 near + 0.2, so far within -0.1 and 0.1 is near within 0.25 and 0.75
    hand = load_hand(
        changed(write_hand, '<mimic joint="middle"', '<limit lower="-0.1" upper="0.1"/><mimic joint="middle"')
    )
    index = hand.joint_names.index("near")
    np.testing.assert_allclose([hand.lower[index], hand.upper[index]], [0.25, 0.75], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("new", "expected"),
    [
        (
            follower('lower="2" upper="3"'),
            (
                "joint 'middle' follows 'near' as 0.8 x + -0.2 and leaves it no range: expected values within its own "
                "limits, 2 to 3, while 'near' goes from 0 to 1.2; mend multiplier, offset or limits"
            ),
        ),
        (
            follower('lower="-0.5" upper="-0.2"'),
            (
                "joint 'middle' follows 'near' as 0.8 x + -0.2 and leaves it no range: expected values within its own "
                "limits, -0.5 to -0.2, while 'near' goes from 0 to 1.2; mend multiplier, offset or limits"
            ),
        ),
        (
            follower('lower="-1.2" upper="-0.2"'),
            (
                "joint 'middle' follows 'near' as 0.8 x + -0.2 and leaves it no range: expected values within its own "
                "limits, -1.2 to -0.2, while 'near' goes from 0 to 1.2; mend multiplier, offset or limits: a multiplier of "
                "-0.8 keeps them"
            ),
        ),
        (
            follower('lower="0" upper="90"'),
            (
                "joint 'middle': expected limits in radians, got 0 to 90, that is up to 5157 degrees; in degrees? write "
                "0.0000 to 1.5708"
            ),
        ),
        (
            follower('lower="1" upper="0"'),
            "joint 'middle': expected lower limit <= upper limit, got 1.0 > 0.0; swap or mend them",
        ),
        (
            follower("", 50, 100),
            (
                "joint 'middle' follows 'near' as 50 x + 100: expected at most 6.38 rad from zero, got 100 to 160; mend "
                "multiplier, offset or its limits"
            ),
        ),
        (
            follower("", 1e300, 1e300),
            (
                "joint 'middle' follows 'near' as 1e+300 x + 1e+300: expected at most 6.38 rad from zero, got 1e+300 to "
                "2.2e+300; mend multiplier, offset or its limits"
            ),
        ),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_follower_that_cannot_be_is_refused_by_name(write_hand, new, expected):
    assert message(changed(write_hand, FOLLOWER, new)).endswith(expected)


def test_a_slide_that_follows_in_another_unit_is_refused(write_hand):
    path = changed(write_hand, FOLLOWER, follower("", 100))
    path.write_text(
        path.read_text().replace('<joint name="middle" type="revolute">', '<joint name="middle" type="prismatic">')
    )
    assert "expected at most 0.5 m from zero, got -0.2 to 119.8; mend multiplier" in message(path)


@pytest.mark.parametrize("limit", ["1e16", "inf", "1e308", "3000"])
@pytest.mark.filterwarnings("error")
def test_limits_that_stand_for_none_are_a_full_turn(write_hand, limit):
    hand = load_hand(
        changed(write_hand, 'lower="0" upper="1.2"', f'lower="-{limit}" upper="{limit}"').with_name("small.urdf")
    )
    index = hand.joint_names.index("near")
    np.testing.assert_array_equal([hand.lower[index], hand.upper[index]], [-np.pi, np.pi])
    assert any("joint 'near': limits of" in note and "stand for none" in note for note in hand.notes)


def test_the_equality_of_an_mjcf_keeps_its_followers_limits(tmp_path):
    finger = '<body name="{0}" pos="{1} 0 0"><joint name="{0}_j" axis="1 0 0" range="0 {2}"/><geom size="0.01"/></body>'
    path = tmp_path / "pair.xml"
    text = (
        '<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom size="0.02"/>'
        f"{finger.format('a', 0.05, 1.2)}{finger.format('b', -0.05, 0.5)}</body></worldbody>"
        '<equality><joint joint1="b_j" joint2="a_j" polycoef="0 {0} 0 0 0"/></equality></mujoco>'
    )
    path.with_suffix(".yaml").write_text("palm: palm\nfingertips: {a: a, b: b}\npalm_normal: [0, 0, 1]")
    path.write_text(text.replace("{0}", "2"))
    hand = load_hand(path)
    assert (hand.joint_names, hand.upper.tolist()) == (("a_j",), [0.25])
    path.write_text(text.replace("{0}", "1e200").replace('range="0 0.5"', 'limited="false"'))
    assert "joint 'b_j' follows 'a_j' as 1e+200 x + 0: expected at most" in message(path)
