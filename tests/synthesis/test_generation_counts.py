"""Attempts are counted once each, in whatever order objects end."""

import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dexnudge.dataset.schema import BEHAVIOURS, BehaviourCounts
from dexnudge.synthesis.generate import generation_log, totals
from dexnudge.synthesis.object_data import ObjectOutcome
from dexnudge.synthesis.recheck import _pick

NUMBERS = st.integers(0, 50)


@st.composite
def behaviour_counts(draw) -> BehaviourCounts:
    kept, failed = draw(NUMBERS), draw(NUMBERS)
    rejected = draw(st.dictionaries(st.sampled_from(["force", "no contact", "penetration self"]), st.integers(1, 50)))
    return BehaviourCounts(
        attempted=kept + failed + sum(rejected.values()), kept=kept, failed=failed, rejected=rejected
    )


OBJECTS = st.dictionaries(
    st.text("abcdef", min_size=1, max_size=4),
    st.dictionaries(st.sampled_from(BEHAVIOURS), behaviour_counts()),
    min_size=1,
    max_size=8,
)


@given(OBJECTS, st.randoms())
def test_totals_add_up_in_any_order(objects, random):
    order = list(objects)
    random.shuffle(order)
    summed = totals({name: objects[name] for name in order})
    assert json.dumps({key: vars(count) for key, count in summed.items()}) == json.dumps(
        {key: vars(count) for key, count in totals(objects).items()}
    )
    for behaviour, count in summed.items():
        count.validate(behaviour)
        for what in ("attempted", "kept", "failed"):
            parts = [getattr(counts[behaviour], what) for counts in objects.values() if behaviour in counts]
            assert getattr(count, what) == sum(parts)


@given(OBJECTS, st.sets(st.text("xyz", min_size=1, max_size=3), max_size=3))
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_the_log_counts_what_the_objects_did(tmp_path, objects, failing):
    (tmp_path / "log.jsonl").write_text('{"event": "end", "ki')  # of a start that was killed amid a line
    with generation_log(tmp_path, total=len(objects) + len(failing), finished=0) as log:
        for name, counts in objects.items():
            log.add(name, ObjectOutcome(counts=counts))
        for name in failing:
            log.add(name, ObjectOutcome(failed="broken"))
    first, *lines = (tmp_path / "log.jsonl").read_text().splitlines()
    assert first == '{"event": "end", "ki'
    *ended, end = map(json.loads, lines)
    assert len(ended) == len(objects) + len(failing)
    assert end["how"] == "done"
    assert end["failed_objects"] == len(failing)
    attempts = [count for counts in objects.values() for count in counts.values()]
    assert end["attempted"] == sum(count.attempted for count in attempts)
    assert end["attempted"] == end["kept"] + sum(end["rejected"].values()) + sum(count.failed for count in attempts)


def test_the_bar_names_rate_yield_and_the_commonest_rejections(tmp_path):
    counts = BehaviourCounts(
        attempted=100,
        kept=25,
        rejected={"force": 40, "no contact": 5, "penetration self": 20, "penetration object": 10},
    )
    with generation_log(tmp_path, total=1, finished=0) as log:
        log.add("phone", ObjectOutcome(counts={"push": counts}))
        assert log.summary().endswith(
            " kept/s, yield 25.0 %; rejected: force 40 %, penetration self 20 %, penetration object 10 %"
        )
        assert float(log.summary().split()[0]) > 0


def test_an_interrupted_run_says_so_in_its_log(tmp_path):
    with pytest.raises(KeyboardInterrupt), generation_log(tmp_path, total=1, finished=0):
        raise KeyboardInterrupt
    assert json.loads((tmp_path / "log.jsonl").read_text())["how"] == "interrupted"


@given(st.dictionaries(st.text("abc", min_size=1), st.integers(0, 9), min_size=1, max_size=6), NUMBERS, NUMBERS)
def test_a_sample_of_rows_has_its_size_and_no_row_twice(rows, num, seed):
    total = sum(rows.values())
    every = _pick(rows, None, seed)
    assert {name: picked.tolist() for name, picked in every.items()} == {
        name: list(range(count)) for name, count in rows.items() if count
    }
    some = _pick(rows, num, seed)
    assert sum(map(len, some.values())) == min(num, total)
    for name, picked in some.items():
        assert len(set(picked.tolist())) == len(picked)
        assert set(picked.tolist()) <= set(range(rows[name]))
