"""What is costly to make from something that never changes, made on first use and kept as long as that lives."""

import weakref
from collections.abc import Callable, Hashable
from functools import wraps
from inspect import signature
from typing import Concatenate, ParamSpec, TypeVar

Key = TypeVar("Key")
Others = ParamSpec("Others")
Made = TypeVar("Made")


def cached_per_instance(make: Callable[Concatenate[Key, Others], Made]) -> Callable[Concatenate[Key, Others], Made]:
    """Decorates a function of one object, told apart by identity and never changed, and of further, hashable arguments."""
    known: dict[int, tuple[weakref.ref[Key], dict[Hashable, Made]]] = {}
    arguments = signature(make)

    @wraps(make)
    def remembered(key: Key, *others: Others.args, **options: Others.kwargs) -> Made:
        place = id(key)
        found = known.get(place)
        if found is None or found[0]() is not key:
            found = (weakref.ref(key, lambda _: known.pop(place, None)), {})
            known[place] = found
        bound = arguments.bind(key, *others, **options)
        bound.apply_defaults()  # what is left out and what is given as its default are the same call
        call = tuple(bound.arguments.values())[1:]
        if call not in found[1]:
            found[1][call] = make(key, *others, **options)
        return found[1][call]

    return remembered
