"""A sampler for given methods, with weights only where a method needs them."""

from collections.abc import Sequence
from pathlib import Path

from dexnudge.errors import UnknownNameError
from dexnudge.hands.hand import Hand
from dexnudge.sampling.methods import METHODS
from dexnudge.sampling.sampler import Sampler


def load_sampler(
    hand: Hand, methods: Sequence[str], *, weights: Path | str | None = None, device: str = "cpu"
) -> Sampler:
    """A sampler that can run all of `methods`; a hand without weights can still run those that start at random.

    Raises:
        UnknownNameError: no such method; the message lists those that exist.
        CheckpointError: weights that are missing, broken or made for another hand.
    """
    for method in methods:
        if method not in METHODS:
            raise UnknownNameError(f"unknown method {method!r}; expected one of {', '.join(METHODS)}")
    if all(METHODS[method].start == "random" for method in methods):
        return Sampler(hand, None, device=device)
    return Sampler.from_pretrained(hand, weights=weights, device=device)
