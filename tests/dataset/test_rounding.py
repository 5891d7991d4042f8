"""What a dataset stores is exact in single precision, near the original, and never better than it."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dexnudge.dataset.schema import (
    JOINT_STEP,
    ROTATION_STEP,
    SLIDE_STEP,
    TRANSLATION_STEP,
    floor_margin,
    round_configuration,
)
from dexnudge.hands.hand import SLIDE_SCALE
from dexnudge.verification.criteria import LIMITS_TOLERANCE, ROTATION_TOLERANCE

SEEDS = st.integers(0, 2**32 - 1)


def draw(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return np.concatenate([rng.uniform(-2.0, 2.0, 3), rotation[:, 0], rotation[:, 1], rng.uniform(-2.0, 2.0, 16)])


@given(SEEDS)
def test_rounded_configurations_are_exact_near_and_stable(seed):
    q = draw(seed)
    rounded = round_configuration(q)
    np.testing.assert_array_equal(rounded.astype(np.float32).astype(np.float64), rounded)
    np.testing.assert_array_equal(round_configuration(rounded), rounded)
    error = np.abs(rounded - q)
    assert error[:3].max() <= TRANSLATION_STEP / 2
    assert error[3:9].max() <= ROTATION_STEP / 2
    assert error[9:].max() <= JOINT_STEP / 2 < LIMITS_TOLERANCE


@given(SEEDS)
def test_rounded_rotations_still_count_as_rotations(seed):
    first, second = round_configuration(draw(seed))[3:9].reshape(2, 3)
    assert np.abs([first @ first - 1.0, second @ second - 1.0, first @ second]).max() < ROTATION_TOLERANCE


@given(SEEDS)
def test_couplings_survive(seed):
    angles = np.sort(draw(seed)[9:])
    rounded = round_configuration(np.concatenate([np.zeros(9), angles]))[9:]
    assert (np.diff(rounded) >= 0.0).all()


@given(st.floats(-1.0, 3.0))
def test_a_stored_margin_never_exceeds_the_true_one(margin):
    stored = floor_margin(np.array([margin]))[0]
    assert margin - 2.0**-10 <= stored <= margin
    assert np.float32(stored) == stored
    assert (stored >= 1.0) == (margin >= 1.0)  # a feasible direction stays feasible
    assert (stored == -1.0) == (margin < -1.0 + 2.0**-10)


def test_batches_and_integers_of_the_step_stay():
    q = np.stack([draw(k) for k in range(6)]).reshape(2, 3, 25)
    np.testing.assert_array_equal(round_configuration(q)[1, 2], round_configuration(q[1, 2]))
    np.testing.assert_array_equal(floor_margin(np.array([-1.0, 1.0, 3.0])), [-1.0, 1.0, 3.0])


@given(SEEDS)
def test_slides_stay_within_what_a_limit_may_be_off(seed):
    q, sliding = draw(seed), np.arange(16) % 3 == 0
    rounded = round_configuration(q, sliding=sliding)
    np.testing.assert_array_equal(rounded.astype(np.float32).astype(np.float64), rounded)
    error = np.abs(rounded - q)[9:]
    assert error[sliding].max() <= SLIDE_STEP / 2 < LIMITS_TOLERANCE * SLIDE_SCALE
    np.testing.assert_array_equal(error[~sliding], np.abs(round_configuration(q) - q)[9:][~sliding])
