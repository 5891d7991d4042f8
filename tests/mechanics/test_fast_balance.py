from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dexnudge.mechanics import fast_balance
from dexnudge.mechanics.balance import balance_problem, problem_margin, solve_balance
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.fast_balance import force_margins
from dexnudge.mechanics.sliding_task import SlidingTask
from dexnudge.scenes.motion import Twist
from dexnudge.scenes.support_contacts import SupportContacts
from highs_margins import HighsMargins

Draw = Callable[..., HandContacts]
TOLERANCE = 2e-3


def random_supports(rng: np.random.Generator, floor: SupportContacts) -> SupportContacts:
    """The floor; an oval of 40 points; floor and ceiling; floor and a wall at the side."""
    kind = rng.integers(4)
    if kind == 1:
        angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        points = np.stack([0.07 * np.cos(angle), 0.03 * np.sin(angle), np.full(40, -0.01)], axis=1)
        return SupportContacts(points=points, normals=np.tile([0.0, 0.0, 1.0], (40, 1)))
    if kind == 2:
        points, normals = floor.points + np.array([0, 0, 0.02]), -floor.normals
    elif kind == 3:
        points, normals = np.array([[-0.07, 0.04, 0.0], [0.07, 0.04, 0.0]]), np.tile([0.0, -1.0, 0.0], (2, 1))
    else:
        return floor
    return SupportContacts(
        points=np.concatenate([floor.points, points]), normals=np.concatenate([floor.normals, normals])
    )


def random_problem(
    rng: np.random.Generator, draw: Draw, floor: SupportContacts, task: SlidingTask
) -> tuple[HandContacts, SupportContacts, SlidingTask]:
    """Contacts, supports and physics; one in five on a ramp, one in four with every contact twice (degenerate)."""
    contacts, supports = draw(rng), random_supports(rng, floor)
    if rng.random() < 0.25:
        contacts = HandContacts(
            points=np.repeat(contacts.points, 2, axis=0),
            normals=np.repeat(contacts.normals, 2, axis=0),
            link=np.repeat(contacts.link, 2),
        )
    yaw = rng.choice([0.0, 0.0, 0.25 * np.pi, rng.uniform(-np.pi, np.pi)])
    tilt = Rotation.from_euler("y", 0.26 if rng.random() < 0.2 else 0.0).as_matrix()
    values = {
        "centre": tilt @ (rng.choice([0.0, 1.0]) * rng.normal(0, 0.005, 3)),
        "twist": Twist(tilt @ np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.zeros(3)),
        "friction_hand": float(rng.choice([0.8, 0.6, 0.3, 0.0])),
        "friction_environment": float(rng.choice([0.4, 0.2, 0.0])),
        "max_normal_force": float(rng.choice([5.0, 1.0, 0.5, 0.0])),
        "mass": float(rng.choice([0.15, 0.01, 2.0])),
    }
    return (
        HandContacts(points=contacts.points @ tilt.T, normals=contacts.normals @ tilt.T, link=contacts.link),
        SupportContacts(points=supports.points @ tilt.T, normals=supports.normals @ tilt.T),
        SlidingTask(**{**task.__dict__, **values}),
    )


@pytest.mark.parametrize("count", [150, pytest.param(2000, marks=pytest.mark.slow)])
def test_margins_equal_those_of_highs(
    count: int, random_contacts: Draw, floor: SupportContacts, task: SlidingTask
) -> None:
    rng = np.random.default_rng(count)
    problems, found = [], []
    for _ in range(count):
        contacts, supports, own = random_problem(rng, random_contacts, floor, task)
        problems.append(balance_problem(contacts, supports, own))
        found.append(force_margins([contacts], supports, own))
    references = HighsMargins(problems).margins()
    np.testing.assert_allclose([each.factor[0, 0] for each in found], references, rtol=0, atol=TOLERANCE)
    for row in np.flatnonzero(references >= 1):
        assert found[row].balanced[0, 0] == (solve_balance(problems[row], factor=1.0) is not None)
    assert 0.1 < np.mean(references == 0) < 0.9
    assert np.mean((references > 0) & (references < 3)) > 0.1


def test_many_margins_of_highs_are_those_of_one_problem_after_the_other(
    random_contacts: Draw, floor: SupportContacts, task: SlidingTask
) -> None:
    rng = np.random.default_rng(150)
    problems = [balance_problem(*random_problem(rng, random_contacts, floor, task)) for _ in range(150)]
    np.testing.assert_array_equal(HighsMargins(problems).margins(), [problem_margin(each) for each in problems])


def test_a_ragged_batch_gives_what_its_members_give(
    random_contacts: Draw, floor: SupportContacts, task: SlidingTask
) -> None:
    rng = np.random.default_rng(1)
    nothing = HandContacts(points=np.zeros((0, 3)), normals=np.zeros((0, 3)), link=np.zeros(0, dtype=int))
    batch = [random_contacts(rng) for _ in range(20)]
    batch.insert(7, nothing)
    angle = 2 * np.pi * np.arange(16) / 16
    twists = [Twist(np.array([np.cos(each), np.sin(each), 0.0]), np.zeros(3)) for each in angle]
    together = force_margins(batch, floor, task, twists=twists, threads=2)
    assert together.factor.shape == (21, 16)
    assert not together.factor[7].any()
    for row in (0, 7, 20):
        alone = force_margins([batch[row]], floor, task, twists=twists, threads=1)
        np.testing.assert_array_equal(together.factor[row], alone.factor[0])
        np.testing.assert_array_equal(together.balanced[row], alone.balanced[0])
    problem = balance_problem(batch[3], floor, task.moving(twists[5]))
    assert together.factor[3, 5] == pytest.approx(problem_margin(problem), abs=TOLERANCE)


def test_a_blocked_motion_has_no_margin(random_contacts: Draw, floor: SupportContacts, task: SlidingTask) -> None:
    walled = SupportContacts(
        points=np.concatenate([floor.points, [[0.08, 0.0, 0.0]]]),
        normals=np.concatenate([floor.normals, [[-1.0, 0.0, 0.0]]]),
    )
    found = force_margins([random_contacts(np.random.default_rng(seed)) for seed in range(5)], walled, task)
    assert not found.factor.any()
    assert not found.balanced.any()


def test_no_configurations_give_no_margins(floor: SupportContacts, task: SlidingTask) -> None:
    assert force_margins([], floor, task).factor.shape == (0, 1)


def test_what_the_kernel_gives_up_is_solved_by_the_reference(
    random_contacts: Draw, floor: SupportContacts, task: SlidingTask, monkeypatch: pytest.MonkeyPatch
) -> None:
    contacts = [random_contacts(np.random.default_rng(seed)) for seed in range(3)]
    zeros = force_margins(contacts, floor, task).factor[:, 0] == 0
    monkeypatch.setattr(fast_balance, "FAILED_MARGIN", 0.0)  # as if every 0 were a failure
    found = force_margins(contacts, floor, task).factor[:, 0]
    assert zeros.any()
    for row in np.flatnonzero(zeros):
        assert found[row] == problem_margin(balance_problem(contacts[row], floor, task))
