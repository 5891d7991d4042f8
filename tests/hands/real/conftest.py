"""Real hands, each read once."""

from collections.abc import Callable
from functools import cache

import pytest

from dexnudge.hands.hand import Hand

from .catalogue import HANDS, LOOPS


@pytest.fixture(scope="session")
def real_hand() -> Callable[[str], Hand]:
    return cache(lambda name: (HANDS | LOOPS)[name].load())
