"""Names of methods in reports."""

from dexnudge.experiments.method_names import NAMES, method_name, method_table
from dexnudge.sampling.methods import METHODS


def test_names_are_of_methods_that_exist_and_no_two_are_alike():
    assert set(NAMES) <= set(METHODS)
    assert len({method_name(method) for method in METHODS}) == len(METHODS)


def test_a_table_names_each_method_once_with_what_it_does():
    lines = method_table(["steered_noise", "unguided", "steered_noise"]).splitlines()
    assert lines[2:] == [
        f"| dexnudge | `ours` | {METHODS['steered_noise'].summary} |",
        f"| prior alone | `unguided` | {METHODS['unguided'].summary} |",
    ]
