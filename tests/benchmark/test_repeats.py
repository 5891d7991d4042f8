"""A draw that is an earlier one once more counts once, by places and angles that were moved by known amounts."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dexnudge.benchmark.repeats import repeated
from dexnudge.hands.registry import load_hand


def draw(hand, *, palm=0.0, turn=0.0, joint=0.0):
    """One hand, its palm moved [m] and turned [rad], its last joint moved [rad, m]."""
    q = np.zeros(9 + hand.num_joints)
    rotation = (Rotation.from_euler("xyz", [0.3, 0.5, 0.7]) * Rotation.from_rotvec([0.0, turn, 0.0])).as_matrix()
    q[:9] = np.concatenate([[0.2, 0.2 + palm, 0.2], rotation[:, 0], rotation[:, 1]])
    q[-1] += joint
    return q


@pytest.mark.parametrize(
    ("name", "moved", "same"),
    [
        ("shadow_lite", {}, True),
        ("shadow_lite", {"palm": 0.9e-3}, True),
        ("shadow_lite", {"palm": 1.1e-3}, False),
        ("shadow_lite", {"turn": 0.9e-2}, True),
        ("shadow_lite", {"turn": 1.1e-2}, False),
        ("shadow_lite", {"joint": -0.9e-2}, True),
        ("shadow_lite", {"joint": -1.1e-2}, False),
        ("panda_gripper", {"joint": 0.9e-3}, True),
        ("panda_gripper", {"joint": 1.1e-3}, False),
    ],
)
def test_a_draw_repeats_another_within_a_millimetre_and_a_hundredth_of_a_radian(name, moved, same):
    hand = load_hand(name)
    assert repeated(np.array([draw(hand), draw(hand, **moved)]), hand).tolist() == [False, same]


def test_draws_are_compared_with_those_that_count_and_nan_with_none():
    hand = load_hand("shadow_lite")
    steps = [draw(hand, palm=0.9e-3 * number) for number in range(4)]
    assert repeated(np.array(steps), hand).tolist() == [False, True, False, True]
    nothing = np.full((2, 9 + hand.num_joints), np.nan)
    assert repeated(nothing, hand).tolist() == [False, False]
    assert repeated(np.concatenate([nothing, steps[:1], nothing, steps[:1]]), hand).tolist() == [False] * 5 + [True]
