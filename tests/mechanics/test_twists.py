"""Turning and tipping against their closed forms, and the kernel against HiGHS for any twist."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from dexnudge.mechanics.balance import EDGE_COUNT, balance_problem, problem_margin, solve_balance
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.fast_balance import force_margins
from dexnudge.mechanics.sliding_task import SlidingTask
from dexnudge.scenes.motion import Turn, Twist
from dexnudge.scenes.support_contacts import SupportContacts
from highs_margins import HighsMargins

Contact = Callable[..., HandContacts]
LENGTH, WIDTH, HEIGHT = 0.16, 0.08, 0.02  # [m] of the block of these tests
FRICTION, MARGIN_STEP = 0.4, 2e-3


def turning(point: list[float], axis: list[float], radius: float) -> Twist:
    """Twist of a turn whose fastest point is `radius` from the axis."""
    angular = np.array(axis, dtype=float) / radius
    return Twist(-np.cross(angular, np.array(point, dtype=float)), angular)


def hand_force(contacts: HandContacts, supports: SupportContacts, task: SlidingTask) -> float:
    """Return the least sum of normal forces of the hand that balances [N]."""
    solution = solve_balance(balance_problem(contacts, supports, task), factor=1.0)
    assert solution is not None
    return float(solution[: len(contacts.points) * EDGE_COUNT].sum() * task.weight)


def ring(count: int, radius: float) -> SupportContacts:
    angle = 2 * np.pi * np.arange(count) / count
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, -HEIGHT / 2)], axis=1)
    return SupportContacts(points=points, normals=np.tile([0.0, 0.0, 1.0], (count, 1)))


@pytest.mark.parametrize("height", [0.05, 0.08, 0.15])
def test_a_block_tips_about_its_edge_at_its_closed_form(task: SlidingTask, contact: Contact, height: float) -> None:
    """Pushed without friction at `height` over the edge that it tips about: F h = m g w / 2; F <= mu m g, or it slides."""
    edge = SupportContacts(
        points=np.array([[0.04, y, 0.0] for y in (-0.02, 0.02)] + [[-0.04, y, 0.0] for y in (-0.02, 0.02)]),
        normals=np.tile([0.0, 0.0, 1.0], (4, 1)),
    )
    twist = turning([0.04, 0, 0], [0, 1, 0], 0.2)
    tipping = replace(task, centre=np.array([0.0, 0.0, 0.08]), twist=twist, friction_hand=0.0)
    push = contact(([-0.04, 0.0, height], [-1.0, 0.0, 0.0]))
    if 0.04 / height > FRICTION:  # it would slide away under the push
        assert solve_balance(balance_problem(push, edge, tipping), factor=1.0) is None
    else:
        assert hand_force(push, edge, tipping) == pytest.approx(task.weight * 0.04 / height, rel=1e-6)
    needed = 0.04 / height / FRICTION  # friction of the pivot from which it stands
    problem = balance_problem(push, edge, tipping)
    least = next(each for each in np.linspace(0, 3, 301) if solve_balance(problem, factor=each) is not None)
    assert least == pytest.approx(needed, abs=0.011)


def test_a_ring_turns_about_its_middle_at_its_closed_form(task: SlidingTask, contact: Contact) -> None:
    """Two pushes F without friction at levers d make the couple 2 F d = mu m g R."""
    pushes = contact(([0.03, -0.04, 0.0], [0.0, -1.0, 0.0]), ([-0.03, 0.04, 0.0], [0.0, 1.0, 0.0]))
    turn = replace(task, twist=turning([0, 0, 0], [0, 0, 1], 0.09), friction_hand=0.0)
    assert hand_force(pushes, ring(12, 0.06), turn) == pytest.approx(FRICTION * task.weight * 0.06 / 0.03, rel=1e-6)


def test_a_bar_turns_about_its_end_at_its_closed_form(task: SlidingTask, contact: Contact) -> None:
    """One end stands, the other slides under m g / 2: a push there needs mu m g / 2."""
    ends = SupportContacts(
        points=np.array([[-0.08, 0, -0.01], [0.08, 0, -0.01]]), normals=np.tile([0.0, 0.0, 1.0], (2, 1))
    )
    push = contact(([0.08, -0.01, -0.01], [0.0, -1.0, 0.0]))
    turn = replace(task, twist=turning([-0.08, 0, 0], [0, 0, 1], 0.16), friction_hand=0.0)
    assert hand_force(push, ends, turn) == pytest.approx(FRICTION * task.weight / 2, rel=1e-6)


@pytest.mark.parametrize("offset", [0.01, 0.03, 0.05, 0.2])
def test_a_ring_is_near_the_ellipsoid_of_its_limit_surface(task: SlidingTask, offset: float) -> None:
    """Friction of a ring, evenly loaded, while it turns about a pole: (F / mu m g)^2 + (M / mu m g R)^2 is about 1.

    The ellipsoid is the usual approximation of the limit surface (Lee and Cutkosky, 1991; Lynch and Mason, 1996).
    """
    pole, rim = np.array([offset, 0.0, 0.0]), ring(64, 0.06)
    problem = balance_problem(
        HandContacts(points=np.zeros((0, 3)), normals=np.zeros((0, 3)), link=np.zeros(0, dtype=int)),
        rim,
        replace(task, twist=turning(pole.tolist(), [0, 0, 1], 0.06 + offset)),
    )
    assert len(problem.support) == 64
    total = problem.support_friction.mean(axis=0)  # over the weight; torque over half of the length
    force, torque = np.linalg.norm(total[:2]) / FRICTION, total[5] * task.half_length / (FRICTION * 0.06)
    assert torque < 0
    assert force**2 + torque**2 == pytest.approx(1.0, abs=0.2)


def random_turn(rng: np.random.Generator) -> Twist:
    """Return a turn about an axis near the block: upright, lying on an edge of its underside, or any."""
    kind = rng.integers(3)
    if kind == 0:
        return turning([*rng.uniform(-0.1, 0.1, 2), 0.0], [0, 0, rng.choice([-1, 1])], 0.15)
    if kind == 1:
        side = rng.choice([-1, 1])
        return turning([side * LENGTH / 2, 0, -HEIGHT / 2], [0, side, 0], 0.16)
    axis = rng.normal(size=3)
    return turning(rng.uniform(-0.1, 0.1, 3).tolist(), (axis / np.linalg.norm(axis)).tolist(), 0.15)


@pytest.mark.parametrize("count", [100, pytest.param(1000, marks=pytest.mark.slow)])
def test_margins_of_turns_equal_those_of_highs(
    count: int, random_contacts: Callable[..., HandContacts], floor: SupportContacts, task: SlidingTask
) -> None:
    rng = np.random.default_rng(count)
    problems, found = [], []
    for _ in range(count):
        contacts, twist = random_contacts(rng), random_turn(rng)
        problems.append(balance_problem(contacts, floor, task.moving(twist)))
        found.append(force_margins([contacts], floor, task.moving(twist)))
    references = HighsMargins(problems).margins()
    np.testing.assert_allclose([each.factor[0, 0] for each in found], references, rtol=0, atol=MARGIN_STEP)
    for problem, reference, each in zip(problems, references, found, strict=True):
        assert each.balanced[0, 0] == (reference >= 1 and solve_balance(problem, factor=1.0) is not None)
    assert 0.1 < np.mean(references == 0) < 0.95


@pytest.mark.parametrize("seed", range(5))
def test_a_rigid_motion_of_everything_changes_no_margin_of_a_tip(
    task: SlidingTask, floor: SupportContacts, random_contacts: Callable[..., HandContacts], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    contacts, twist = random_contacts(rng), turning([0.08, 0, -0.01], [0, 1, 0], 0.16)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler("z", rng.uniform(-3, 3)).as_matrix(), rng.normal(size=3)
    rotation, shift = pose[:3, :3], pose[:3, 3]
    there = replace(task, centre=shift, twist=twist.moved(pose))
    moved = HandContacts(
        points=contacts.points @ rotation.T + shift, normals=contacts.normals @ rotation.T, link=contacts.link
    )
    under = SupportContacts(points=floor.points @ rotation.T + shift, normals=floor.normals)
    before = problem_margin(balance_problem(contacts, floor, task.moving(twist)))
    assert problem_margin(balance_problem(moved, under, there)) == pytest.approx(before, abs=MARGIN_STEP)


def test_a_standing_contact_carries_its_whole_cone(task: SlidingTask) -> None:
    """Any force inside the pyramid of a pivot is a combination of its eight columns, none outside of it is."""
    pivot = SupportContacts(points=np.zeros((1, 3)), normals=np.array([[0.0, 0.0, 1.0]]))
    nothing = HandContacts(points=np.zeros((0, 3)), normals=np.zeros((0, 3)), link=np.zeros(0, dtype=int))
    problem = balance_problem(nothing, pivot, task.moving(turning([0, 0, 0], [0, 1, 0], 0.1)))
    columns = (problem.support_normal + problem.support_friction)[:, :3].T
    for angle in np.linspace(0, 2 * np.pi, 33):
        for size, inside in ((0.99 * np.cos(np.pi / EDGE_COUNT), True), (1.01, False)):
            wanted = np.array([size * FRICTION * np.cos(angle), size * FRICTION * np.sin(angle), 1.0])
            found = linprog(np.zeros(columns.shape[1]), A_eq=columns, b_eq=wanted).success
            assert found == inside


def test_a_turn_carries_points_as_its_twist_says() -> None:
    """The twist is the derivative of the displacement."""
    turn = Turn(0.7, np.array([0.0, 1.0, 1.0]), np.array([0.1, 0.0, 0.2]))
    point, step = np.array([0.3, -0.2, 0.1]), 1e-6
    twist = Twist(-np.cross(turn.axis, turn.point), turn.axis)
    moved = (turn.transform(step) @ [*point, 1.0])[:3]
    np.testing.assert_allclose((moved - point) / step, twist.velocity(point), atol=1e-5)
