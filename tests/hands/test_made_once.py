"""What a hand is asked for once is made once, for that hand alone, and goes when the hand goes."""

import gc
import weakref
from dataclasses import dataclass, replace

import pytest
import trimesh

from dexnudge.hands.hand import Hand
from dexnudge.jobs.cached import cached_per_instance


class Costly:
    """What was made, of a hand with that name."""

    def __init__(self, name: str) -> None:
        self.name = name


@pytest.fixture
def made():
    """A decorated function and the names of the hands that it was called for."""
    calls: list[str] = []

    @cached_per_instance
    def make(hand: Hand) -> Costly:
        """Makes it."""
        calls.append(hand.name)
        return Costly(hand.name)

    return make, calls


def test_made_once_for_each_hand(made, small):
    make, calls = made
    equal, other = replace(small), replace(small, name="other")
    assert make(small) is make(small)
    assert calls == [small.name]
    assert make(other).name == "other"
    assert make(equal) is not make(small)  # by identity: equal arrays are not looked at
    assert make(small).name == small.name
    assert calls == [small.name, "other", small.name]
    assert make.__doc__ == "Makes it."


def test_made_anew_where_a_mesh_was_changed_in_place():
    @dataclass(frozen=True)
    class Held:
        mesh: trimesh.Trimesh

    @cached_per_instance
    def volume(held: Held) -> float:
        return held.mesh.volume

    held = Held(trimesh.creation.box((1, 1, 1)))
    assert volume(held) == pytest.approx(1.0)
    held.mesh.vertices[:, 2] *= 2
    assert volume(held) == pytest.approx(2.0)
    held.mesh.apply_scale(2.0)
    assert volume(held) == pytest.approx(16.0)


def test_two_functions_do_not_share_what_they_made(small):
    one, two = (
        cached_per_instance(lambda hand: Costly(hand.name + "1")),
        cached_per_instance(lambda hand: Costly(hand.name + "2")),
    )
    assert (one(small).name, two(small).name) == (small.name + "1", small.name + "2")


def test_freed_with_the_hand_and_made_anew_for_the_next(made, small):
    make, calls = made
    for turn in range(20):  # a new hand often gets the address of the one before
        hand = replace(small, name=f"hand {turn}")
        result = weakref.ref(make(hand))
        assert make(hand).name == hand.name
        del hand
        gc.collect()
        assert result() is None
    assert calls == [f"hand {turn}" for turn in range(20)]


def test_what_fails_to_be_made_is_tried_again(small):
    attempts = []

    @cached_per_instance
    def make(hand: Hand) -> Costly:
        attempts.append(hand.name)
        if len(attempts) == 1:
            raise MemoryError
        return Costly(hand.name)

    with pytest.raises(MemoryError):
        make(small)
    assert make(small).name == small.name
    assert len(attempts) == 2
