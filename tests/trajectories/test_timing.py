"""Trajectories keep every limit, stay near their way, and are about as fast as ruckig and TOPP-RA have them."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruckig import InputParameter, Ruckig, Trajectory

from dexnudge.arms.arm import JointLimits
from dexnudge.arms.registry import HOME, LIMITS
from dexnudge.errors import InputError
from dexnudge.trajectories.interpolation import at, limits_used
from dexnudge.trajectories.timing import SAMPLE_INTERVAL, concatenated, hold, time_optimal, timed_way

NOISE = 1e-5  # [rad] of inverse kinematics


def alike(number, lower, upper, velocity, acceleration, jerk):
    return JointLimits(*(np.full(number, value) for value in (lower, upper, velocity, acceleration, jerk, 1.0)))


FINGERS = alike(3, -0.2, 1.5, 2.0, 20.0, 400.0)
UR = alike(6, -2 * np.pi, 2 * np.pi, np.pi, 5.0, 50.0)
ROBOTS = [LIMITS, UR, FINGERS, LIMITS + FINGERS, UR + FINGERS]


def assert_within(trajectory, limits):
    """Limits by our own count; by finite differences each millisecond; and of the samples alone."""
    used = limits_used(trajectory, limits)
    assert used.exceeded == ()
    assert max(share.max() for share in (used.velocity, used.acceleration, used.jerk)) <= 1.0 + 1e-6
    step = 0.001
    time = np.arange(round(trajectory.duration / step) + 1) * step
    position = at(trajectory, time).position
    assert (position >= limits.lower - 1e-6).all()
    assert (position <= limits.upper + 1e-6).all()
    for order, bound in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk)):
        assert (np.abs(np.diff(position, order, axis=0)) <= bound * step**order * 1.0001 + 1e-12).all()
    coarse = np.gradient(trajectory.position, SAMPLE_INTERVAL, axis=0)
    assert (np.abs(coarse) <= limits.velocity * 1.0001).all()
    assert (np.abs(np.gradient(trajectory.velocity, SAMPLE_INTERVAL, axis=0)) <= limits.acceleration * 1.0001).all()
    assert (np.abs(np.gradient(trajectory.acceleration, SAMPLE_INTERVAL, axis=0)) <= limits.jerk * 1.0001).all()


def assert_from_rest_to_rest(trajectory, start, goal):
    assert np.allclose(trajectory.position[[0, -1]], [start, goal], atol=1e-9)
    assert not trajectory.velocity[[0, -1]].any()
    assert not trajectory.acceleration[[0, -1]].any()
    assert np.allclose(trajectory.time, np.arange(len(trajectory.time)) * SAMPLE_INTERVAL)
    assert not trajectory.effort.any()


def distance(position, path):
    """Return how far from a polyline each position is: of the nearest point, the joint that is farthest."""
    farthest = []
    for start, goal in pairwise(path):
        share = ((position - start) @ (goal - start) / ((goal - start) @ (goal - start))).clip(0, 1)
        farthest.append(np.abs(position - start - share[:, None] * (goal - start)).max(axis=1))
    return np.min(farthest, axis=0)


def ruckig_time(distance, velocity, acceleration, jerk):
    wanted, found = InputParameter(1), Trajectory(1)
    wanted.target_position, wanted.max_velocity = [distance], [velocity]
    wanted.max_acceleration, wanted.max_jerk = [acceleration], [jerk]
    Ruckig(1).calculate(wanted, found)
    return found.duration


def random_path(rng, limits, waypoints):
    size = 10 ** rng.uniform(-3, 0.3)
    moves = rng.normal(size=(waypoints, len(limits.lower))) * (rng.random((waypoints, len(limits.lower))) < 0.6)
    return (rng.uniform(limits.lower, limits.upper) * 0.3 + np.cumsum(moves, axis=0) * size).clip(
        limits.lower, limits.upper
    )


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    robot=st.sampled_from(range(len(ROBOTS))),
    waypoints=st.integers(2, 10),
    corner=st.sampled_from([0.0, 0.001, 0.03, 0.1]),
)
def test_a_polyline_is_passed_within_limits_and_near_it(seed, robot, waypoints, corner):
    limits = ROBOTS[robot]
    path = random_path(np.random.default_rng(seed), limits, waypoints)
    trajectory = time_optimal(path, limits, corner=corner)
    assert_from_rest_to_rest(trajectory, path[0], path[-1])
    assert_within(trajectory, limits)
    distinct = path[np.r_[True, np.abs(np.diff(path, axis=0)).max(axis=1) > 1e-9]]
    if len(distinct) > 1:
        time = np.linspace(0, trajectory.duration, 300)
        assert distance(at(trajectory, time).position, distinct).max() <= corner + 1e-6


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    robot=st.sampled_from(range(len(ROBOTS))),
    stations=st.integers(1, 80),
    speed=st.sampled_from([0.02, 0.05, 0.25, 1.0, None]),
)
def test_a_way_is_passed_within_limits(seed, robot, stations, speed):
    limits, rng = ROBOTS[robot], np.random.default_rng(seed)
    progress = np.arange(stations) * 0.002
    bends = rng.normal(size=(3, len(limits.lower))) * 10 ** rng.uniform(-2, 0)
    powers = (progress[:, None] / 0.1) ** np.arange(1, 4)
    way = limits.lower + (limits.upper - limits.lower) * rng.random(len(limits.lower)) + powers @ bends
    way = (way + rng.normal(size=way.shape) * NOISE).clip(limits.lower, limits.upper)
    trajectory = timed_way(way, progress, limits, speed=speed)
    assert_from_rest_to_rest(trajectory, way[0], way[-1])
    assert_within(trajectory, limits)


@pytest.mark.parametrize("distance", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("limits", ROBOTS, ids=["panda", "ur", "fingers", "panda-fingers", "ur-fingers"])
def test_a_straight_motion_takes_hardly_longer_than_ruckig_s(distance, limits):
    shares = np.linspace(1.0, 0.2, len(limits.lower)) * (-1.0) ** np.arange(len(limits.lower))
    free = JointLimits(**(vars(limits) | {"lower": limits.lower - 9, "upper": limits.upper + 9}))
    step = shares * distance
    least = ruckig_time(
        1.0, *(float((bound / np.abs(step)).min()) for bound in (limits.velocity, limits.acceleration, limits.jerk))
    )
    found = time_optimal(np.stack([np.zeros_like(step), step]), free, share=1.0).duration
    assert least <= found <= max(1.1 * least, least + 2.5 * SAMPLE_INTERVAL)


def test_one_joint_takes_the_time_of_the_closed_form():
    limits = alike(1, -5.0, 5.0, 1.0, 4.0, 40.0)
    # d / v + v / a + a / j: a cruise at v between two S-shaped ramps that each reach a.
    closed = 2.0 / 1.0 + 1.0 / 4.0 + 4.0 / 40.0
    assert closed <= time_optimal(np.array([[0.0], [2.0]]), limits, share=1.0).duration <= closed + 2 * SAMPLE_INTERVAL


def test_rounded_corners_are_faster_than_stops():
    path = np.array([[0.0, 0.0, 0.0], [0.5, 0.3, 0.0], [1.0, 0.2, 0.4], [1.2, 0.8, 0.6]])
    stops, narrow, wide = (time_optimal(path, FINGERS, corner=corner).duration for corner in (0.0, 0.02, 0.1))
    assert wide < narrow < 0.85 * stops


def test_a_push_keeps_its_speed():
    progress = np.arange(51) * 0.002
    bends = np.stack([np.sin(progress * number + number) for number in range(1, 8)], axis=1)
    way = HOME + bends + np.random.default_rng(0).normal(size=bends.shape) * NOISE
    trajectory = timed_way(way, progress, LIMITS, speed=0.05, ramp=0.2)
    assert trajectory.duration == pytest.approx(0.1 / 0.05 + 0.2, abs=0.03)
    time = np.linspace(0.25, trajectory.duration - 0.25, 50)
    number = np.arange(1, 8)
    angle = number * (1 + 0.05 + 0.05 * (time[:, None] - trajectory.duration / 2))  # half-way at half the time
    state = at(trajectory, time)
    assert np.abs(state.position - HOME - np.sin(angle)).max() < 2e-4
    assert np.abs(state.velocity - 0.05 * number * np.cos(angle)).max() < 0.002
    assert (
        np.abs(state.acceleration + (0.05 * number) ** 2 * np.sin(angle)).max() < 0.1
    )  # of 7.5: noise is not amplified


def test_a_way_is_slower_only_where_the_limits_demand_it():
    progress = np.linspace(0.0, 1.0, 501)
    bend = 0.1 * progress + 0.5 * (1 + np.tanh((progress - 0.5) / 0.02))  # a joint that turns 1 rad within some 8 cm
    trajectory = timed_way(bend[:, None], progress, alike(1, -5.0, 5.0, 1.0, 20.0, 1000.0), speed=0.5, share=1.0)
    assert 2.0 + 0.2 < trajectory.duration < 3.3  # 1.84 s at 0.5 m/s, and 1 rad at 1 rad/s
    ends = at(trajectory, np.array([0.4, trajectory.duration - 0.4])).velocity
    assert ends == pytest.approx(0.05, abs=1e-3)


def test_nothing_that_moves_takes_one_interval():
    path = np.tile(HOME, (4, 1))
    assert time_optimal(path, LIMITS).duration == SAMPLE_INTERVAL
    assert time_optimal(path[:1], LIMITS).duration == SAMPLE_INTERVAL
    assert timed_way(path, np.arange(4.0), LIMITS).duration == SAMPLE_INTERVAL
    assert timed_way(path, np.arange(4) * 0.01, LIMITS, speed=0.1).duration == pytest.approx(0.3 + 0.2, abs=0.02)
    assert hold(HOME, 0.0).duration == SAMPLE_INTERVAL
    assert hold(HOME, 0.031).duration == pytest.approx(0.04)


def test_trajectories_are_joined_on_one_grid():
    path = np.array([[0.0, 0.0, 0.0], [0.5, 0.3, 0.1], [1.0, 0.2, 0.4]])
    there, back = time_optimal(path, FINGERS), time_optimal(path[::-1], FINGERS)
    joined = concatenated(there, hold(path[-1], 0.1), back)
    assert np.allclose(joined.time, np.arange(len(joined.time)) * SAMPLE_INTERVAL, atol=1e-12)
    assert joined.duration == pytest.approx(there.duration + 0.1 + back.duration)
    assert len(joined.time) == len(joined.position) == len(joined.effort)
    assert_within(joined, FINGERS)
    time = np.linspace(0, back.duration, 77)
    later = at(joined, time + there.duration + 0.1)
    assert np.allclose(later.position, at(back, time).position, atol=1e-9)


def test_trajectories_that_do_not_meet_are_not_joined():
    path = np.array([[0.0, 0.0, 0.0], [0.5, 0.3, 0.1]])
    with pytest.raises(ValueError, match=r"trajectory 2 does not start as the one before ends: position jumps by 0\.5"):
        concatenated(time_optimal(path, FINGERS), time_optimal(path, FINGERS))


def test_limits_without_bound_are_no_bound():
    path = np.array([[0.0, 0.0, 0.0], [0.5, 0.3, 0.1], [1.0, 0.2, 0.4]])
    endless = np.full(3, np.inf)
    free = JointLimits(**(vars(FINGERS) | {"acceleration": endless, "jerk": endless}))
    assert time_optimal(path, free, share=1.0).duration == pytest.approx(1.0 / 2.0, abs=0.06)  # at 2 rad/s


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_path_that_is_not_finite_is_refused(wrong):
    path = np.zeros((4, 3))
    path[2, 1] = wrong
    for call in (lambda: time_optimal(path, FINGERS), lambda: timed_way(path, np.arange(4.0), FINGERS)):
        with pytest.raises(InputError, match="`path`: row 2 of it is not finite; expected joint positions"):
            call()
