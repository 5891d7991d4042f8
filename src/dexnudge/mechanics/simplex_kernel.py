"""A simplex method for the force balance in Warp: each worker solves one small feasibility problem, in float64.

Find x >= 0 with sum_j x_j A_j = b (6 rows) and, for each hand link, the sum of its x_j and a slack equal to the cap.
Phase one is composite (Maros, Computational Techniques of the Simplex Method, 2003, ch. 9): the sum of the basic
values' bound violations is minimised, so any basis can start it, and the next factor starts from the last one's.
Dantzig's rule prices; a streak of degenerate pivots switches to Bland's rule, which cannot cycle.
"""

from dexnudge.geometry.warp_runtime import wp
from dexnudge.mechanics import friction_cone

# Warp's annotations are values, not types.
# mypy: ignore-errors


wp.set_module_options({"enable_backward": False, "max_unroll": 1})

SINGULAR = wp.constant(wp.float64(1e-10))
"""Pivot below which a working basis counts as singular [-]; its columns are of order 1."""
EDGES = wp.constant(friction_cone.EDGE_COUNT)
ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))

vec6 = wp.types.vector(length=6, dtype=wp.float64)


@wp.struct
class Program:
    """One worker's linear program and basis; the arrays are the worker's own rows of the scratch memory."""

    edges: wp.array(dtype=vec6)  # 8 per hand contact
    edge_link: wp.array(dtype=wp.int32)  # per hand contact
    normal: wp.array(dtype=vec6)  # a support's wrench is normal + factor * friction
    friction: wp.array(dtype=vec6)
    contacts: wp.int32
    supports: wp.int32
    links: wp.int32
    cap: wp.float64
    right_side: vec6  # b
    key: wp.array(dtype=wp.int32)  # per link: its key column, the value of that, and its part of the reduced costs
    key_value: wp.array(dtype=wp.float64)
    key_price: wp.array(dtype=wp.float64)
    basis: wp.array(dtype=wp.int32)  # per slot of the working basis: its column and the value of that
    value: wp.array(dtype=wp.float64)
    inverse: wp.array(dtype=vec6)  # row r is COLUMN r of the inverse of the working basis
    scratch: wp.array(dtype=vec6)


@wp.func
def column(p: Program, index: wp.int32, factor: wp.float64) -> vec6:
    """Return the six balance rows of column `index`."""
    result = vec6()
    edges = p.contacts * EDGES
    if index < edges:
        result = p.edges[index]
    elif index < edges + p.supports:
        result = p.normal[index - edges] + factor * p.friction[index - edges]
    elif index >= edges + p.supports + p.links:
        result[index - edges - p.supports - p.links] = ONE
    return result


@wp.func
def link_of(p: Program, index: wp.int32) -> wp.int32:
    """Return the link whose cap column `index` counts towards, or -1."""
    result = wp.int32(-1)
    slack = index - p.contacts * EDGES - p.supports
    if index < p.contacts * EDGES:
        result = p.edge_link[index // EDGES]
    elif slack >= 0 and slack < p.links:
        result = slack
    return result


@wp.func
def is_artificial(p: Program, index: wp.int32) -> wp.bool:
    """Return whether column `index` is fixed at zero."""
    return index >= p.contacts * EDGES + p.supports + p.links


@wp.func
def reduced_column(p: Program, index: wp.int32, factor: wp.float64) -> vec6:
    """Return column `index` less the key column of its link."""
    result = column(p, index, factor)
    link = link_of(p, index)
    if link >= 0:
        result = result - column(p, p.key[link], factor)
    return result


@wp.func
def cold_start(p: Program):
    """Make the slacks the keys and the artificials the working basis."""
    first = p.contacts * EDGES + p.supports
    for link in range(p.links):
        p.key[link] = first + link
    for slot in range(6):
        p.basis[slot] = first + p.links + slot


@wp.func
def factorise(p: Program, factor: wp.float64) -> wp.bool:
    """Invert the working basis and compute the basic values; return False where it is singular."""
    for slot in range(6):
        p.scratch[slot] = reduced_column(p, p.basis[slot], factor)
        unit = vec6()
        unit[slot] = ONE
        p.inverse[slot] = unit
    for pivot in range(6):
        best = wp.int32(pivot)
        for row in range(pivot + 1, 6):
            if wp.abs(p.scratch[row][pivot]) > wp.abs(p.scratch[best][pivot]):
                best = row
        size = p.scratch[best][pivot]
        if wp.abs(size) < SINGULAR:
            return False
        work = p.scratch[best] / size
        inverse = p.inverse[best] / size
        p.scratch[best] = p.scratch[pivot]
        p.inverse[best] = p.inverse[pivot]
        p.scratch[pivot] = work
        p.inverse[pivot] = inverse
        for row in range(6):
            share = p.scratch[row][pivot]
            if row != pivot and share != ZERO:
                p.scratch[row] = p.scratch[row] - share * work
                p.inverse[row] = p.inverse[row] - share * inverse
    rest = p.right_side
    for link in range(p.links):
        rest = rest - p.cap * column(p, p.key[link], factor)
        p.key_value[link] = p.cap
    values = vec6()
    for row in range(6):
        values = values + rest[row] * p.inverse[row]
    for slot in range(6):
        p.value[slot] = values[slot]
        link = link_of(p, p.basis[slot])
        if link >= 0:
            p.key_value[link] = p.key_value[link] - values[slot]
    return True


@wp.func
def rate_of_key(p: Program, link: wp.int32, rate: vec6, entering_link: wp.int32) -> wp.float64:
    """Return the rate at which the key value of `link` falls: its link's sum stays at the cap."""
    result = ZERO
    if link == entering_link:
        result = ONE
    for slot in range(6):
        if link_of(p, p.basis[slot]) == link:
            result = result - rate[slot]
    return result


@wp.func
def exchange(p: Program, leave: wp.int32, enter: wp.int32, enter_link: wp.int32, rate: vec6, step: wp.float64):
    """Put column `enter`, at value `step`, instead of the basic one at `leave` (slots, then keys)."""
    slot = leave
    if leave >= 6:
        # a key leaves: another basic column of its link becomes the key, and the old key takes that one's slot
        link = leave - 6
        slot = wp.int32(-1)
        members = vec6()
        for other in range(6):
            if link_of(p, p.basis[other]) == link:
                members[other] = ONE
                if slot < 0 or p.value[other] > p.value[slot]:
                    slot = other
        if slot < 0:
            p.key[link] = enter
            p.key_value[link] = step
            return
        rate[slot] = rate_of_key(p, link, rate, enter_link)
        p.key[link] = p.basis[slot]
        p.key_value[link] = p.value[slot]
        for row in range(6):
            entries = p.inverse[row]
            entries[slot] = -wp.dot(entries, members)
            p.inverse[row] = entries
    p.basis[slot] = enter
    p.value[slot] = step
    for row in range(6):
        entries = p.inverse[row]
        share = entries[slot] / rate[slot]
        entries = entries - share * rate
        entries[slot] = share
        p.inverse[row] = entries


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
def solve(p: Program, factor: wp.float64) -> wp.int32:
    """Minimise the violations from the present basis; return FEASIBLE, INFEASIBLE or FAILED."""
    streak = wp.int32(0)
    for pivot in range(MAX_PIVOTS):
        if pivot % REFACTOR_INTERVAL == 0:  # noqa: SIM102 - Warp evaluates both sides of an `and`
            if not factorise(p, factor):
                # The basis of slacks and artificials is the identity.
                cold_start(p)
                factorise(p, factor)
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
