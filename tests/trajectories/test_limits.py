"""Limits used: by closed forms of one joint, and which joint exceeds what, and when."""

import numpy as np
import pytest
from scipy.interpolate import BPoly

from dexnudge.arms.arm import JointLimits
from dexnudge.trajectories.interpolation import at, limits_used
from dexnudge.trajectories.plan import JointTrajectory

LIMITS = JointLimits(
    *(np.array(pair, dtype=float) for pair in ([-1, -2], [1, 2], [1, 2], [10, 20], [100, 200], [1, 1]))
)


def trajectory(time, position, velocity, acceleration):
    return JointTrajectory(
        *(np.array(values, dtype=float) for values in (time, position, velocity, acceleration)),
        np.zeros((len(time), 2)),
    )


@pytest.fixture
def swing():
    """From rest to rest in a second: the quintic 10 x^3 - 15 x^4 + 6 x^5, times 0.8 and 1.6."""
    return trajectory([0, 1], [[0, 0], [0.8, 1.6]], np.zeros((2, 2)), np.zeros((2, 2)))


def test_shares_are_those_of_the_closed_form(swing):
    used = limits_used(swing, LIMITS)
    assert used.position == pytest.approx([0.8, 0.8])
    assert used.velocity == pytest.approx([0.8 * 15 / 8] * 2, abs=1e-5)  # 15/8 at the middle
    assert used.acceleration == pytest.approx([0.8 * 10 / np.sqrt(3) / 10] * 2, abs=1e-5)
    assert used.jerk == pytest.approx([0.8 * 60 / 100] * 2)  # 60 at both ends


def test_what_is_exceeded_is_named(swing):
    worst = limits_used(swing, LIMITS, ["shoulder", "elbow"]).exceeded
    assert [(each.joint, each.limit, each.time) for each in worst] == [
        ("shoulder", "velocity", pytest.approx(0.5)),
        ("elbow", "velocity", pytest.approx(0.5)),
    ]
    assert str(worst[0]) == "joint 'shoulder' uses 150.0% of its velocity limit at 0.500 s"


def test_a_jerk_between_two_samples_is_seen():
    calm = trajectory([0, 0.01, 0.02], np.zeros((3, 2)), np.zeros((3, 2)), [[0, 0], [0, 1], [0, 0]])
    used = limits_used(calm, LIMITS)
    assert used.exceeded[0].limit == "jerk"
    assert used.jerk[1] == pytest.approx(
        9 / 0.01 / 200
    )  # quintic of an acceleration that rises to 1 with no net motion


def test_a_joint_without_ends_and_one_that_rests_on_its_limit_exceed_nothing():
    free = JointLimits(**(vars(LIMITS) | {"lower": np.array([-np.inf, -2.0]), "upper": np.array([np.inf, 2.0])}))
    still = trajectory([0, 1], [[50, 2], [50, 2]], np.zeros((2, 2)), np.zeros((2, 2)))
    used = limits_used(still, free)
    assert used.exceeded == ()
    assert used.position == pytest.approx([0.0, 1.0])
    beyond = trajectory([0, 1], [[0, 2.1], [0, 2.1]], np.zeros((2, 2)), np.zeros((2, 2)))
    assert [each.limit for each in limits_used(beyond, LIMITS).exceeded] == ["position"]


def test_between_samples_scipy_s_hermite_interpolation_is_met():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.005, 0.02, 6))
    values = rng.normal(size=(3, 6, 2))
    found = at(trajectory(time, *values), np.linspace(time[0], time[-1], 50)[:-1])
    reference = BPoly.from_derivatives(time, values.transpose(1, 0, 2))
    for order, name in enumerate(found._fields):
        expected = reference(np.linspace(time[0], time[-1], 50)[:-1], order)
        assert np.allclose(getattr(found, name), expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_joints_rest_before_and_after():
    moving = trajectory([0, 1], [[0, 0], [1, 1]], [[1, 1], [1, 1]], np.zeros((2, 2)))
    state = at(moving, np.array([-1.0, 0.5, 2.0]))
    assert state.position[:, 0] == pytest.approx([0, 0.5, 1])
    assert state.velocity[:, 0] == pytest.approx([0, 1, 0])
