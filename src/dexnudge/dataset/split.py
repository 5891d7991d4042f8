"""Which objects are held out: decided by the object's name alone, so that it never depends on the rest of the set."""

import hashlib
from collections.abc import Sequence

VALIDATION_FRACTION = 0.05  # of the objects; the test set is made of other objects altogether


def hash_fraction(object_name: str) -> float:
    """A number in [0, 1) that depends on the name only and is spread evenly over names."""
    digest = hashlib.sha256(object_name.encode()).digest()
    return int.from_bytes(digest[:8], "big") / 2.0**64


def split_objects(
    names: Sequence[str], *, validation_fraction: float = VALIDATION_FRACTION
) -> tuple[list[int], list[int]]:
    """Indices of training and validation objects.

    An object is held out when its hash falls below `validation_fraction`. With two or more objects neither side is
    empty: the smallest hash is then held out, or the largest one kept for training.
    """
    fractions = [hash_fraction(name) for name in names]
    held_out = [index for index, fraction in enumerate(fractions) if fraction < validation_fraction]
    order = sorted(range(len(names)), key=fractions.__getitem__)
    if len(names) >= 2 and validation_fraction > 0.0:
        if not held_out:
            held_out = order[:1]
        elif len(held_out) == len(names):
            held_out = sorted(order[:-1])
    training = [index for index in range(len(names)) if index not in set(held_out)]
    return training, held_out
