"""Benchmarks are scripts: what they import lies beside them."""

import sys
from pathlib import Path

import pytest

from dexnudge.hands.hand import Hand

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))


@pytest.fixture(scope="session")
def hand(shadow_hand: Hand) -> Hand:
    return shadow_hand
