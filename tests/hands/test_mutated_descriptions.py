"""Small descriptions with elements, attributes or lines changed at random: a hand, or one message, never a traceback."""

import random

import pytest

from dexnudge.errors import DexnudgeError
from dexnudge.hands.registry import load_hand
from hostile.hands import DRAWS


@pytest.mark.parametrize(("kind", "draws"), [("urdf", 60), ("yaml", 60), ("mjcf", 20)])
def test_a_hand_or_a_message(tmp_path, kind, draws):
    read = 0
    for seed in range(draws):
        case, folder = DRAWS[kind](random.Random(seed)), tmp_path / str(seed)
        case.write(folder)
        try:
            read += load_hand(folder / case.arguments[1]).num_joints > 0
        except DexnudgeError:
            continue
    assert 0 < read < draws
