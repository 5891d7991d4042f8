"""Joints belong to the digit whose fingertip they carry."""

import pytest

from dexnudge.dataset.manifest import joint_groups
from dexnudge.hands.registry import load_hand


@pytest.mark.parametrize(
    ("name", "prefixes"),
    [("shadow_lite", {"FF", "MF", "RF", "TH"}), ("shadow_full", {"FF", "MF", "RF", "LF", "TH", "WR"})],
)
def test_shadow_joints_carry_their_digit_in_their_name(name, prefixes):
    hand = load_hand(name)
    digits = joint_groups(hand)
    assert sorted(index for joints in digits.values() for index in joints) == list(range(len(hand.joint_names)))
    by_prefix = {p: {k for k, joint in enumerate(hand.joint_names) if joint.startswith(p)} for p in prefixes}
    assert sorted(map(sorted, digits.values())) == sorted(map(sorted, by_prefix.values()))
