"""The best direction of motion against a search over the arcs of equally good ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dexnudge.dataset.schema import INFEASIBLE, NUM_DIRECTIONS, best_direction

FEW_VALUES = st.lists(st.sampled_from([INFEASIBLE, 0.5, 2.0, 3.0]), min_size=NUM_DIRECTIONS, max_size=NUM_DIRECTIONS)
ANY_VALUES = st.lists(st.floats(-1.0, 3.0), min_size=NUM_DIRECTIONS, max_size=NUM_DIRECTIONS)


def arcs(margin: np.ndarray) -> list[list[int]]:
    """Directions of greatest margin in runs around the ring, each run in its order."""
    best = [bool(value == max(margin)) for value in margin]
    if all(best):
        return [list(range(len(best)))]
    found = []
    for start in range(len(best)):
        if best[start] and not best[start - 1]:
            run = [start]
            while best[(run[-1] + 1) % len(best)]:
                run.append((run[-1] + 1) % len(best))
            found.append(run)
    return found


@given(FEW_VALUES | ANY_VALUES)
def test_it_lies_in_the_middle_of_a_widest_arc(values):
    margin = np.asarray(values)
    found = best_direction(margin)
    assert margin[found] == max(values)
    (mine,) = [arc for arc in arcs(margin) if found in arc]
    place = mine.index(found)
    assert abs(place - (len(mine) - 1 - place)) <= 1 or len(mine) == NUM_DIRECTIONS
    # An arc of even length has two middles, each with as many neighbours on its narrower side as one of odd length.
    assert (len(mine) - 1) // 2 == max((len(arc) - 1) // 2 for arc in arcs(margin))


@given(FEW_VALUES, st.integers(0, NUM_DIRECTIONS - 1))
def test_a_turned_ring_has_a_turned_best_direction(values, turn):
    margin = np.asarray(values)
    runs = sorted((arc for arc in arcs(margin)), key=len)
    unique = len(runs[-1]) % 2 == 1 and (len(runs) == 1 or len(runs[-2]) < len(runs[-1]))
    if unique and len(runs[-1]) < NUM_DIRECTIONS:
        middle = runs[-1][len(runs[-1]) // 2]
        assert best_direction(margin) == middle
        assert best_direction(np.roll(margin, turn)) == (middle + turn) % NUM_DIRECTIONS


@pytest.mark.parametrize("value", [INFEASIBLE, 3.0])
def test_where_all_are_equal_it_is_the_first(value):
    assert best_direction(np.full(NUM_DIRECTIONS, value)) == 0


@pytest.mark.parametrize(
    ("best", "expected"),
    [([0], 0), ([15, 0, 1], 0), ([14, 15, 0], 15), ([4, 5, 6, 12], 5), ([2, 8, 9, 10, 11, 12], 10)],
)
def test_arcs_that_pass_through_zero_and_arcs_that_compete(best, expected):
    margin = np.full(NUM_DIRECTIONS, 1.0)
    margin[best] = 2.0
    assert best_direction(margin) == expected
