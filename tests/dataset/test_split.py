"""The split depends on names alone and leaves neither side empty."""

from hypothesis import given
from hypothesis import strategies as st

from dexnudge.dataset.loading import hash_fraction, split_objects

NAMES = st.lists(st.text(min_size=1, max_size=8), min_size=2, max_size=40, unique=True)


@given(NAMES)
def test_every_object_is_on_one_side(names):
    training, held_out = split_objects(names)
    assert sorted(training + held_out) == list(range(len(names)))
    assert training
    assert held_out


def test_adding_objects_moves_none_across():
    names = [f"object-{k}" for k in range(500)]
    _, few = split_objects(names[:250])
    _, many = split_objects(names)
    assert few == [k for k in many if k < 250]


def test_the_share_is_about_right():
    names = [f"object-{k}" for k in range(4000)]
    _, held_out = split_objects(names)
    assert 150 < len(held_out) < 250  # binomial: 200 +- 14
    assert abs(sum(map(hash_fraction, names)) / len(names) - 0.5) < 0.02  # uniform: standard error 0.005
    assert split_objects(["alone"]) == ([0], [])
