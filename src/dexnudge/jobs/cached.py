"""What is costly to make from something that never changes, made on first use and kept as long as that lives."""

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

Key = TypeVar("Key")
Made = TypeVar("Made")


def cached_per_instance(make: Callable[[Key], Made]) -> Callable[[Key], Made]:
    """Decorates a function of one object; objects are told apart by identity, and never changed."""
    known: dict[int, tuple[weakref.ref[Key], Made]] = {}

    @wraps(make)
    def remembered(key: Key) -> Made:
        found = known.get(id(key))
        if found is None or found[0]() is not key:
            place = id(key)
            found = (weakref.ref(key, lambda _: known.pop(place, None)), make(key))
            known[place] = found
        return found[1]

    return remembered
