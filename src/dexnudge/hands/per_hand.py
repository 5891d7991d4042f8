"""What is costly to make from a hand, made on first use and kept as long as the hand is."""

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

from dexnudge.hands.hand import Hand

Made = TypeVar("Made")


def per_hand(make: Callable[[Hand], Made]) -> Callable[[Hand], Made]:
    """Decorates a function of a hand; hands are told apart by identity, and never changed."""
    known: dict[int, tuple[weakref.ref[Hand], Made]] = {}

    @wraps(make)
    def remembered(hand: Hand) -> Made:
        found = known.get(id(hand))
        if found is None or found[0]() is not hand:
            key = id(hand)
            found = (weakref.ref(hand, lambda _: known.pop(key, None)), make(hand))
            known[key] = found
        return found[1]

    return remembered
