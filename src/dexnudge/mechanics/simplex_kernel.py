"""A simplex method for the force balance in Warp: each worker solves one small feasibility problem, in float64.

Find x >= 0 with sum_j x_j A_j = b (6 rows) and, for each hand link, the sum of its x_j and a slack equal to the cap.
Phase one is composite (Maros, Computational Techniques of the Simplex Method, 2003, ch. 9): the sum of the basic
values' bound violations is minimised, so any basis can start it, and the next factor starts from the last one's.
Dantzig's rule prices; a streak of degenerate pivots switches to Bland's rule, which cannot cycle.
"""

# Warp's annotations are values, not types.
# mypy: ignore-errors

from dexnudge.geometry.warp_runtime import wp
from dexnudge.mechanics.simplex_basis import (
    EDGES,
    ONE,
    ZERO,
    Program,
    cold_start,
    column,
    exchange,
    factorise,
    is_artificial,
    link_of,
    rate_of_key,
    reduced_column,
    vec6,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

INFEASIBLE = wp.constant(0)
FEASIBLE = wp.constant(1)
FAILED = wp.constant(2)
"""What `solve` returns; FAILED is left to another solver."""

VALUE_TOLERANCE = wp.constant(wp.float64(1e-9))
"""Violation up to which a basic value counts as at its bound [weights]."""
ACCEPT_TOLERANCE = wp.constant(wp.float64(1e-7))
"""Sum of violations that counts as balanced [weights]: HiGHS' own feasibility tolerance."""
PRICE_TOLERANCE = wp.constant(wp.float64(1e-9))
PIVOT_TOLERANCE = wp.constant(wp.float64(1e-8))
TIE_TOLERANCE = wp.constant(wp.float64(1e-10))
MAX_PIVOTS = wp.constant(600)
DEGENERATE_STREAK = wp.constant(24)
REFACTOR_INTERVAL = wp.constant(24)


@wp.func
def violation_slope(value: wp.float64, artificial: wp.bool) -> wp.float64:
    """Return the slope of a basic value's violation: -1 below zero, +1 above it for an artificial."""
    result = ZERO
    if value < -VALUE_TOLERANCE:
        result = -ONE
    elif artificial and value > VALUE_TOLERANCE:
        result = ONE
    return result


@wp.func
def step_limit(value: wp.float64, rate: wp.float64, artificial: wp.bool) -> wp.float64:
    """Return the step at which a basic value, falling at `rate`, reaches its bound; -1 if it never does."""
    result = -ONE
    if wp.abs(rate) > PIVOT_TOLERANCE:
        if wp.abs(value) > VALUE_TOLERANCE:
            if value * rate > ZERO:
                result = value / rate
        elif artificial or rate > ZERO:
            result = ZERO
    return result


@wp.func
def entering(p: Program, y: vec6, factor: wp.float64, bland: wp.bool) -> wp.int32:
    """Return the column of the most negative reduced cost (under Bland's rule the first negative one), or -1."""
    best = wp.int32(-1)
    least = -PRICE_TOLERANCE
    for contact in range(p.contacts):
        price = p.key_price[p.edge_link[contact]]
        for edge in range(contact * EDGES, contact * EDGES + EDGES):
            cost = price - wp.dot(y, p.edges[edge])
            if cost < least:
                least = cost
                best = edge
                if bland:
                    return best
    first = p.contacts * EDGES
    for support in range(p.supports):
        cost = -wp.dot(y, p.normal[support]) - factor * wp.dot(y, p.friction[support])
        if cost < least:
            least = cost
            best = first + support
            if bland:
                return best
    for link in range(p.links):
        if p.key_price[link] < least:
            least = p.key_price[link]
            best = first + p.supports + link
            if bland:
                return best
    return best


@wp.func
def price(p: Program, factor: wp.float64):
    """Return the multipliers of the balance rows and the sum of violations; set each link's share of the prices."""
    violation = ZERO
    slopes = vec6()
    for slot in range(6):
        slope = violation_slope(p.value[slot], is_artificial(p, p.basis[slot]))
        violation += slope * p.value[slot]
        link = link_of(p, p.basis[slot])
        if link >= 0:
            slope -= violation_slope(p.key_value[link], False)
        slopes[slot] = slope
    y = vec6()
    for row in range(6):
        y[row] = wp.dot(p.inverse[row], slopes)
    for link in range(p.links):
        slope = violation_slope(p.key_value[link], False)
        violation += slope * p.key_value[link]
        p.key_price[link] = wp.dot(y, column(p, p.key[link], factor)) - slope
    return y, violation


@wp.func
def longest_step(p: Program, rate: vec6, enter_link: wp.int32) -> wp.float64:
    """Return the step at which the first basic value reaches its bound; infinity if none does."""
    step = wp.float64(wp.inf)
    for slot in range(6):
        limit = step_limit(p.value[slot], rate[slot], is_artificial(p, p.basis[slot]))
        if limit >= ZERO:
            step = wp.min(step, limit)
    for link in range(p.links):
        limit = step_limit(p.key_value[link], rate_of_key(p, link, rate, enter_link), False)
        if limit >= ZERO:
            step = wp.min(step, limit)
    return step


@wp.func
def leaving(p: Program, rate: vec6, enter_link: wp.int32, step: wp.float64, bland: wp.bool) -> wp.int32:
    """Return who leaves at `step` (slots 0..5, then keys): the largest pivot, under Bland's rule the first column."""
    place = wp.int32(-1)
    best = ZERO
    for candidate in range(6 + p.links):
        index = wp.int32(0)
        value = ZERO
        fall = ZERO
        if candidate < 6:
            index = p.basis[candidate]
            value = p.value[candidate]
            fall = rate[candidate]
        else:
            index = p.key[candidate - 6]
            value = p.key_value[candidate - 6]
            fall = rate_of_key(p, candidate - 6, rate, enter_link)
        limit = step_limit(value, fall, is_artificial(p, index))
        if limit >= ZERO and limit <= step + TIE_TOLERANCE:
            score = wp.abs(fall)
            if bland:
                score = ONE / wp.float64(index + 1)
            if score > best:
                best = score
                place = candidate
    return place


@wp.func
def restart_if_singular(p: Program, factor: wp.float64):
    """Factorise the basis; where that fails, begin again with slacks and artificials, whose basis is the identity."""
    if not factorise(p, factor):
        cold_start(p)
        factorise(p, factor)


@wp.func
def solve(p: Program, factor: wp.float64) -> wp.int32:
    """Minimise the violations from the present basis; return FEASIBLE, INFEASIBLE or FAILED."""
    streak = wp.int32(0)
    for pivot in range(MAX_PIVOTS):
        if pivot % REFACTOR_INTERVAL == 0:
            restart_if_singular(p, factor)
        y, violation = price(p, factor)
        if violation == ZERO:
            return FEASIBLE
        bland = streak > DEGENERATE_STREAK
        enter = entering(p, y, factor, bland)
        if enter < 0:
            if violation <= ACCEPT_TOLERANCE:
                return FEASIBLE
            return INFEASIBLE
        enter_link = link_of(p, enter)
        direction = reduced_column(p, enter, factor)
        rate = vec6()
        for row in range(6):
            rate = rate + direction[row] * p.inverse[row]
        step = longest_step(p, rate, enter_link)
        if not wp.isfinite(step):
            return FAILED
        leave = leaving(p, rate, enter_link, step, bland)
        streak = wp.int32(0) if step > TIE_TOLERANCE else streak + 1
        for link in range(p.links):
            p.key_value[link] = p.key_value[link] - step * rate_of_key(p, link, rate, enter_link)
        for slot in range(6):
            p.value[slot] = p.value[slot] - step * rate[slot]
        exchange(p, leave, enter, enter_link, rate, step)
    return FAILED
