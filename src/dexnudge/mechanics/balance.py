"""The quasi-static force balance of a moving object as a linear program, solved by HiGHS: the reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import OptimizeResult, linprog

from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.friction_cone import EDGE_COUNT, friction_cone_edges, wrenches
from dexnudge.mechanics.sliding_task import SlidingTask
from dexnudge.mechanics.support_forces import support_forces
from dexnudge.scenes.support_contacts import SupportContacts

MAX_FACTOR = 3.0
"""Largest factor on friction_environment that is tried [-]."""
SCAN_STEP = 0.25
"""Step of the coarse scan over the factor [-]; 1 and 1.5, which decide success and robustness, are on the grid."""
BISECTIONS = 8
"""Halvings of one step of the scan: 0.25 / 2**8 is just below 1e-3."""
LINPROG_INFEASIBLE = 2


@dataclass(frozen=True, kw_only=True)
class BalanceProblem:
    """The linear program of one set of contacts and one twist, forces in units of the weight.

    sum_jk lambda_jk hand[j, k] + sum_i N_i (support_normal[i] + factor * support_friction[i]) = -load,
    lambda, N >= 0, sum of lambda over a link <= cap. Rows: force, then torque about the centre of mass divided by
    half of the object's length.

    hand: wrench of each pyramid edge at unit normal force. link: 0..links-1 per hand contact.
    support_normal, support_friction: wrenches of a unit normal force and of the full friction at that force: one of a
    contact that slides, 8 in all directions of one that stands.
    support: of which of the support contacts these are; the motion separates the others.
    blocked: the motion runs into a support contact, so no force balances it.
    """

    hand: Float[np.ndarray, "contact edge 6"]
    link: Int[np.ndarray, "contact"]
    support_normal: Float[np.ndarray, "column 6"]
    support_friction: Float[np.ndarray, "column 6"]
    support: Int[np.ndarray, "column"]
    load: Float[np.ndarray, "6"]
    cap: float
    blocked: bool


@dataclass(frozen=True, kw_only=True)
class ContactForces:
    """Forces on the object that balance it [N, world]."""

    hand: Float[np.ndarray, "contact 3"]
    support: Float[np.ndarray, "support 3"]


def balance_problem(contacts: HandContacts, supports: SupportContacts, task: SlidingTask) -> BalanceProblem:
    """Build the linear program of DESIGN's success condition.

    With v the velocity of the object at a support contact, its fastest point moving at 1, and n the environment's normal
    there: |v| <= 0.02 stands, as a pivot does, and carries any force of its friction cone, by the edges of the inner
    8-edge pyramid; n.v > 1e-3 separates and carries nothing; n.v < -1e-3 blocks the motion; else it slides along
    t = (v - (v.n) n) / |.| and carries N (n - friction_environment t). Of an object that turns on a plane the corners of
    the supports' hull carry it, where friction resists the turn most.
    """
    force, friction, support, blocked = support_forces(supports, task)
    arm = supports.points[support]
    edges = friction_cone_edges(contacts.normals, task.twist.direction(contacts.points), friction=task.friction_hand)
    return BalanceProblem(
        hand=wrenches(contacts.points[:, None], edges, centre=task.centre, half_length=task.half_length),
        link=np.unique(contacts.link, return_inverse=True)[1].reshape(-1),
        support_normal=wrenches(arm, force, centre=task.centre, half_length=task.half_length),
        support_friction=wrenches(arm, friction, centre=task.centre, half_length=task.half_length),
        support=support,
        load=np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]),
        cap=task.max_normal_force / task.weight,
        blocked=blocked,
    )


def solve_balance(problem: BalanceProblem, *, factor: float) -> Float[np.ndarray, "variable"] | None:
    """Return forces in units of the weight that balance at `factor`, hand edges first, or None if there are none.

    Among all of them, the ones with the least sum of normal components of the hand. Raises RuntimeError where HiGHS
    ends without an answer.
    """
    if problem.blocked:
        return None
    hand = problem.hand.reshape(-1, 6)
    support = problem.support_normal + factor * problem.support_friction
    columns = np.concatenate([hand, support]).T
    if columns.shape[1] == 0:
        return None
    links = int(problem.link.max()) + 1 if len(problem.link) else 0
    caps = np.zeros((links, columns.shape[1]))
    caps[np.repeat(problem.link, EDGE_COUNT), np.arange(len(hand))] = 1.0
    # On rare degenerate problems HiGHS ends in "unknown" with presolve, on rarer ones without it as well.
    for method, presolve in (("highs", True), ("highs", False), ("highs-ipm", True)):
        result: OptimizeResult = linprog(
            np.concatenate([np.ones(len(hand)), np.zeros(len(support))]),
            A_ub=caps if links else None,
            b_ub=np.full(links, problem.cap) if links else None,
            A_eq=columns,
            b_eq=-problem.load,
            method=method,
            options={"presolve": presolve},
        )
        if result.success or result.status == LINPROG_INFEASIBLE:
            break
    if result.status == LINPROG_INFEASIBLE:
        return None
    if not result.success:
        raise RuntimeError(f"HiGHS gave no answer to a force balance (status {result.status}): {result.message}")
    return np.asarray(result.x, dtype=np.float64)


def problem_margin(problem: BalanceProblem) -> float:
    """Return the largest factor in [0, 3] on friction_environment at which `problem` is feasible, to 1e-3 from below.

    Feasibility need not be monotone in the factor (an object on a ramp needs some friction not to run away), so the
    factors 3, 2.75, ..., 0 are tried from above, and the step over the first feasible one is halved 8 times.
    Returns 0 where none of them is feasible.
    """
    if problem.blocked:
        return 0.0
    for step in range(round(MAX_FACTOR / SCAN_STEP), -1, -1):
        low = step * SCAN_STEP
        if solve_balance(problem, factor=low) is not None:
            break
    else:
        return 0.0
    if low == MAX_FACTOR:
        return low
    width = SCAN_STEP
    for _ in range(BISECTIONS):
        width *= 0.5
        if solve_balance(problem, factor=low + width) is not None:
            low += width
    return low


def contact_forces(contacts: HandContacts, supports: SupportContacts, task: SlidingTask) -> ContactForces | None:
    """Return the balancing forces with the least total normal force of the hand, or None if nothing balances."""
    problem = balance_problem(contacts, supports, task)
    solution = solve_balance(problem, factor=1.0)
    if solution is None:
        return None
    count = len(contacts.points)
    normal_forces = solution[: count * EDGE_COUNT].reshape(count, EDGE_COUNT) * task.weight
    support = np.zeros_like(supports.points)
    columns = problem.support_normal + problem.support_friction
    np.add.at(support, problem.support, solution[count * EDGE_COUNT :, None] * columns[:, :3] * task.weight)
    return ContactForces(
        hand=np.einsum("ck,ckx->cx", normal_forces, np.ascontiguousarray(problem.hand[..., :3])),
        support=support,
    )
