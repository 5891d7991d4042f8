from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from dexnudge.mechanics.balance import (
    BalanceProblem,
    balance_problem,
    contact_forces,
    problem_margin,
    solve_balance,
)
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.sliding_task import SlidingTask
from dexnudge.scenes.motion import Twist
from dexnudge.scenes.support_contacts import SupportContacts

Contact = Callable[..., HandContacts]
few = settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
seeds = st.integers(0, 2**32 - 1)
TOP = ([0.0, 0.0, 0.01], [0.0, 0.0, 1.0])


def changed(task: SlidingTask, **values: float | np.ndarray | Twist) -> SlidingTask:
    return SlidingTask(**{**task.__dict__, **values})


@pytest.mark.parametrize("friction", [0.1, 0.2, 0.4, 0.7])
def test_a_press_from_above_needs_its_closed_form(
    task: SlidingTask, floor: SupportContacts, contact: Contact, friction: float
) -> None:
    task = changed(task, friction_environment=friction, max_normal_force=50.0)
    forces = contact_forces(contact(TOP), floor, task)
    assert forces is not None
    assert -forces.hand[0, 2] == pytest.approx(friction * task.weight / (0.8 - friction), rel=1e-6)


def test_a_press_from_above_has_the_margin_at_which_the_link_reaches_its_limit(
    task: SlidingTask, floor: SupportContacts, contact: Contact
) -> None:
    # 0.8 N = 0.4 factor (m g + N) at N = 5
    expected = 0.8 * 5.0 / (0.4 * (task.weight + 5.0))
    found = problem_margin(balance_problem(contact(TOP), floor, task))
    assert expected - 1e-3 <= found <= expected


@pytest.mark.parametrize("friction", [0.8, 1.0])
def test_a_press_cannot_drag_over_as_much_friction_as_it_has(
    task: SlidingTask, floor: SupportContacts, contact: Contact, friction: float
) -> None:
    task = changed(task, friction_environment=friction, max_normal_force=1e6)
    assert contact_forces(contact(TOP), floor, task) is None


def test_a_frictionless_push_level_with_the_floor_needs_the_friction_force(
    task: SlidingTask, floor: SupportContacts, contact: Contact
) -> None:
    task = changed(task, friction_hand=0.0)
    forces = contact_forces(contact(([-0.08, 0.0, -0.01], [-1.0, 0.0, 0.0])), floor, task)
    assert forces is not None
    assert forces.hand[0, 0] == pytest.approx(0.4 * task.weight, rel=1e-6)


def test_finger_friction_unloads_the_floor(task: SlidingTask, floor: SupportContacts, contact: Contact) -> None:
    behind = [([-0.08, y, -0.01], [-1.0, 0.0, 0.0]) for y in (-0.02, 0.02)]
    forces = contact_forces(contact(*behind), floor, task)
    assert forces is not None
    assert forces.hand[:, 0].sum() < 0.4 * task.weight
    assert forces.hand[:, 0].sum() == pytest.approx(0.4 * (task.weight - forces.hand[:, 2].sum()), rel=1e-6)


def test_pushing_on_the_wrong_side_is_impossible(task: SlidingTask, floor: SupportContacts, contact: Contact) -> None:
    in_front = contact(([0.08, 0.0, 0.0], [1.0, 0.0, 0.0]))
    assert problem_margin(balance_problem(in_front, floor, changed(task, friction_hand=0.3))) == 0.0


def test_forces_balance_and_stay_in_their_cones(
    task: SlidingTask, floor: SupportContacts, random_contacts: Callable[..., HandContacts]
) -> None:
    solved = 0
    for seed in range(30):
        contacts = random_contacts(np.random.default_rng(seed))
        forces = contact_forces(contacts, floor, task)
        if forces is None:
            continue
        solved += 1
        points = np.concatenate([contacts.points, floor.points])
        all_forces = np.concatenate([forces.hand, forces.support])
        np.testing.assert_allclose(all_forces.sum(axis=0), [0, 0, task.weight], atol=1e-5)
        np.testing.assert_allclose(np.cross(points, all_forces).sum(axis=0), 0, atol=1e-6)
        normal = -np.einsum("cx,cx->c", forces.hand, contacts.normals)
        tangential = np.linalg.norm(forces.hand + normal[:, None] * contacts.normals, axis=1)
        assert (tangential <= 0.8 * normal + 1e-6).all()
        np.testing.assert_allclose(forces.support[:, 0], -0.4 * forces.support[:, 2], atol=1e-6)
        for link in np.unique(contacts.link):
            assert normal[contacts.link == link].sum() <= task.max_normal_force + 1e-5
    assert solved >= 10


def farkas(problem: BalanceProblem, factor: float) -> bool:
    """Whether multipliers prove the balance impossible.

    y.(-load) > cap * sum of z, with y.column <= z of its link (0 for supports) and z >= 0, contradicts any forces.
    """
    hand = problem.hand.reshape(-1, 6)
    support = problem.support_normal + factor * problem.support_friction
    links = int(problem.link.max()) + 1
    own = np.zeros((len(hand), links))
    own[np.arange(len(hand)), np.repeat(problem.link, 8)] = 1.0
    rows = np.block([[hand, -own], [support, np.zeros((len(support), links))]])
    result = linprog(
        np.concatenate([problem.load, np.full(links, problem.cap)]),
        A_ub=rows,
        b_ub=np.zeros(len(rows)),
        bounds=[(-1, 1)] * 6 + [(0, None)] * links,
        method="highs",
    )
    return bool(result.fun < -1e-7)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_exactly_one_of_forces_and_farkas_multipliers_exists(
    task: SlidingTask, floor: SupportContacts, random_contacts: Callable[..., HandContacts], factor: float
) -> None:
    answers = []
    for seed in range(40):
        problem = balance_problem(random_contacts(np.random.default_rng(seed)), floor, task)
        possible = solve_balance(problem, factor=factor) is not None
        assert possible != farkas(problem, factor)
        answers.append(possible)
    assert 5 < sum(answers) < 40


@few
@given(seed=seeds)
def test_a_rigid_motion_about_the_vertical_changes_nothing(
    task: SlidingTask, floor: SupportContacts, random_contacts: Callable[..., HandContacts], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    contacts = random_contacts(rng)
    turn, shift = Rotation.from_euler("z", rng.uniform(-3, 3)).as_matrix(), rng.normal(size=3)
    moved = HandContacts(points=contacts.points @ turn.T + shift, normals=contacts.normals @ turn.T, link=contacts.link)
    under = SupportContacts(points=floor.points @ turn.T + shift, normals=floor.normals)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, shift
    there = changed(task, centre=shift, twist=task.twist.moved(pose))
    before = problem_margin(balance_problem(contacts, floor, task))
    after = problem_margin(balance_problem(moved, under, there))
    assert after == pytest.approx(before, abs=2e-3)


@few
@given(seed=seeds)
def test_the_order_of_contacts_changes_nothing(
    task: SlidingTask, floor: SupportContacts, random_contacts: Callable[..., HandContacts], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    contacts = random_contacts(rng)
    order, corners = rng.permutation(len(contacts.points)), rng.permutation(4)
    shuffled = HandContacts(
        points=contacts.points[order], normals=contacts.normals[order], link=100 - contacts.link[order]
    )
    under = SupportContacts(points=floor.points[corners], normals=floor.normals[corners])
    before = problem_margin(balance_problem(contacts, floor, task))
    assert problem_margin(balance_problem(shuffled, under, task)) == pytest.approx(before, abs=2e-3)


def test_a_wall_in_front_blocks_the_motion(task: SlidingTask, floor: SupportContacts, contact: Contact) -> None:
    walled = SupportContacts(
        points=np.concatenate([floor.points, [[0.08, 0.0, 0.0]]]),
        normals=np.concatenate([floor.normals, [[-1.0, 0.0, 0.0]]]),
    )
    problem = balance_problem(contact(TOP), walled, task)
    assert problem.blocked
    assert problem_margin(problem) == 0.0


def test_a_wall_that_is_left_behind_carries_nothing(
    task: SlidingTask, floor: SupportContacts, contact: Contact
) -> None:
    walled = SupportContacts(
        points=np.concatenate([floor.points, [[-0.08, 0.0, 0.0]]]),
        normals=np.concatenate([floor.normals, [[1.0, 0.0, 0.0]]]),
    )
    found = problem_margin(balance_problem(contact(TOP), walled, task))
    assert found == problem_margin(balance_problem(contact(TOP), floor, task))


def test_a_hand_that_only_holds_back_on_a_ramp_needs_some_friction(
    task: SlidingTask, floor: SupportContacts, contact: Contact
) -> None:
    """Pushing downhill on 15 degrees: it runs away below factor tan(15)/0.4 = 0.67, and needs a push above."""
    slope = np.radians(15.0)
    tilt = Rotation.from_euler("y", slope).as_matrix()
    uphill = contact(([-0.08, 0.0, -0.01], [-1.0, 0.0, 0.0]))
    contacts = HandContacts(points=uphill.points @ tilt.T, normals=uphill.normals @ tilt.T, link=uphill.link)
    under = SupportContacts(points=floor.points @ tilt.T, normals=floor.normals @ tilt.T)
    problem = balance_problem(
        contacts, under, changed(task, friction_hand=0.0, twist=Twist(tilt @ task.twist.linear, np.zeros(3)))
    )
    threshold = np.tan(slope) / 0.4
    assert solve_balance(problem, factor=threshold - 0.01) is None
    assert solve_balance(problem, factor=threshold + 0.01) is not None
    assert problem_margin(problem) == 3.0


def test_without_any_contact_the_object_stays(task: SlidingTask, floor: SupportContacts) -> None:
    nothing = HandContacts(points=np.zeros((0, 3)), normals=np.zeros((0, 3)), link=np.zeros(0, dtype=int))
    nowhere = SupportContacts(points=np.zeros((0, 3)), normals=np.zeros((0, 3)))
    assert problem_margin(balance_problem(nothing, floor, task)) == 0.0
    assert problem_margin(balance_problem(nothing, nowhere, task)) == 0.0
