"""The basis of the force balance's simplex method in Warp: columns, working basis, exchange.

The caps on the hand links are generalised upper bounds (Dantzig & Van Slyke, 1967): each link has one basic "key"
column, and only the 6 x 6 working basis of the other basic columns, less their link's key, is inverted.

Column numbers: hand edges (8 per contact) | sliding supports | one slack per link | 6 artificials, fixed at zero.
"""

# Warp's annotations are values, not types.
# mypy: ignore-errors

from dexnudge.geometry.warp_runtime import wp
from dexnudge.mechanics import friction_cone

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
    """Put column `enter`, at value `step`, in the place of the basic one at `leave` (slots, then keys)."""
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
