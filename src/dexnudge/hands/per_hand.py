"""What is costly to make from a hand, made on first use and kept as long as the hand is."""

from collections.abc import Callable
from typing import TypeVar

from dexnudge.hands.hand import Hand
from dexnudge.made_once import made_once

Made = TypeVar("Made")


def per_hand(make: Callable[[Hand], Made]) -> Callable[[Hand], Made]:
    """Decorates a function of a hand; hands are told apart by identity, and never changed."""
    return made_once(make)
