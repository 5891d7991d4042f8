"""The hand of all benchmarks' tests."""

import pytest

from dexnudge.hands.hand import Hand


@pytest.fixture(scope="session")
def hand(shadow_hand: Hand) -> Hand:
    return shadow_hand
