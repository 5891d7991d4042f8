"""Benchmarks are scripts: what they import lies beside them."""

import sys
from pathlib import Path

import pytest

from dexnudge.hands.hand import Hand
from dexnudge.hands.named.shadow_lite import shadow_lite

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))


@pytest.fixture(scope="session")
def hand() -> Hand:
    return shadow_lite()
