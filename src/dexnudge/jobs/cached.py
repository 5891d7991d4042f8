"""What is costly to make, made on first use and kept as long as what it is made from lives and its meshes do not change."""

import weakref
from collections.abc import Callable, Hashable
from functools import wraps
from inspect import signature
from typing import Concatenate, ParamSpec, TypeVar

import trimesh

Key = TypeVar("Key")
Others = ParamSpec("Others")
Made = TypeVar("Made")


def cached_per_instance(make: Callable[Concatenate[Key, Others], Made]) -> Callable[Concatenate[Key, Others], Made]:
    """Decorates a function of one object, told apart by identity, and of further, hashable arguments.

    The object never changes, but for the vertices and faces of a mesh that it is or has as an attribute.
    """
    known: dict[int, tuple[weakref.ref[Key], list[int], dict[Hashable, Made]]] = {}
    arguments = signature(make)

    @wraps(make)
    def remembered(key: Key, *others: Others.args, **options: Others.kwargs) -> Made:
        place = id(key)
        found, meshes = known.get(place), _meshes(key)
        if found is None or found[0]() is not key or found[1] != meshes:
            found = (weakref.ref(key, lambda _: known.pop(place, None)), meshes, {})
            known[place] = found
        bound = arguments.bind(key, *others, **options)
        bound.apply_defaults()  # what is left out and what is given as its default are the same call
        call = tuple(bound.arguments.values())[1:]
        if call not in found[2]:
            found[2][call] = make(key, *others, **options)
        return found[2][call]

    return remembered


def _meshes(key: object) -> list[int]:
    """Return hashes of a mesh, or of the meshes among an object's attributes; trimesh keeps them until one is changed."""
    return [hash(each) for each in (key, *getattr(key, "__dict__", {}).values()) if isinstance(each, trimesh.Trimesh)]
