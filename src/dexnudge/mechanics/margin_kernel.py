"""The Warp kernel that builds each force balance from contacts and searches its force margin."""

# Warp's annotations are values, not types.
# mypy: ignore-errors

import math

from dexnudge.geometry.warp_runtime import wp
from dexnudge.mechanics import balance, friction_cone
from dexnudge.mechanics.simplex_kernel import FAILED, FEASIBLE, ONE, ZERO, Program, cold_start, solve, vec6
from dexnudge.scenes import support_contacts

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

FAILED_MARGIN = -1.0
"""Margin written where the simplex method gave up."""
PIVOT_SPEED = wp.constant(wp.float64(support_contacts.PIVOT_SPEED))
MOTION_TOLERANCE = wp.constant(wp.float64(support_contacts.MOTION_TOLERANCE))
ALIGNMENT_LIMIT = wp.constant(wp.float64(friction_cone.ALIGNMENT_LIMIT))
EDGE_COUNT = wp.constant(friction_cone.EDGE_COUNT)
EDGE_ANGLE = wp.constant(wp.float64(2.0 * math.pi / friction_cone.EDGE_COUNT))
MAX_FACTOR = wp.constant(wp.float64(balance.MAX_FACTOR))
SCAN_STEP = wp.constant(wp.float64(balance.SCAN_STEP))
BISECTIONS = wp.constant(balance.BISECTIONS)
_FAILED_MARGIN = wp.constant(wp.float64(FAILED_MARGIN))


@wp.struct
class Memory:
    """The arrays of every worker's `Program`, a row for each worker."""

    edges: wp.array2d(dtype=vec6)
    normal: wp.array2d(dtype=vec6)
    friction: wp.array2d(dtype=vec6)
    key: wp.array2d(dtype=wp.int32)
    key_value: wp.array2d(dtype=wp.float64)
    key_price: wp.array2d(dtype=wp.float64)
    basis: wp.array2d(dtype=wp.int32)
    value: wp.array2d(dtype=wp.float64)
    inverse: wp.array2d(dtype=vec6)
    scratch: wp.array2d(dtype=vec6)


MEMORY_TYPES = {name: variable.type.dtype for name, variable in Memory.vars.items()}


@wp.func
def wrench(point: wp.vec3d, force: wp.vec3d) -> vec6:
    """Return force then torque about the origin."""
    torque = wp.cross(point, force)
    return vec6(force[0], force[1], force[2], torque[0], torque[1], torque[2])


@wp.func
def first_tangent(normal: wp.vec3d, motion: wp.vec3d) -> wp.vec3d:
    """Return the unit tangent that `friction_cone.contact_tangents` puts first."""
    tangent = motion - wp.dot(motion, normal) * normal
    if wp.length(tangent) < ALIGNMENT_LIMIT:
        up = wp.vec3d(ZERO, ZERO, ONE)
        tangent = up - normal[2] * normal
        if wp.length(tangent) < ALIGNMENT_LIMIT:
            tangent = wp.vec3d(ONE, ZERO, ZERO) - normal[0] * normal
    return wp.normalize(tangent)


@wp.func
def cone_edge(normal: wp.vec3d, tangent: wp.vec3d, edge: wp.int32, friction: wp.float64) -> wp.vec3d:
    """Return the tangential force of one edge of the friction pyramid at unit normal force."""
    angle = EDGE_ANGLE * wp.float64(edge)
    return friction * (wp.cos(angle) * tangent + wp.sin(angle) * wp.cross(normal, tangent))


@wp.func
def search(p: Program) -> wp.vec2d:
    """Return the margin (scan from above, then bisection; -1 if the method failed) and 1 if balanced at factor 1."""
    cold_start(p)
    low = MAX_FACTOR
    status = solve(p, low)
    while status != FEASIBLE and status != FAILED and low > ZERO:
        low = low - SCAN_STEP
        status = solve(p, low)
    if status == FAILED:
        return wp.vec2d(_FAILED_MARGIN, ZERO)
    if status != FEASIBLE:
        return wp.vec2d(ZERO, ZERO)
    width = SCAN_STEP
    if low < MAX_FACTOR:
        for _halving in range(BISECTIONS):
            width = width * wp.float64(0.5)
            status = solve(p, low + width)
            if status == FEASIBLE:
                low = low + width
            elif status == FAILED:
                return wp.vec2d(_FAILED_MARGIN, ZERO)
    balanced = ZERO
    if low >= ONE:
        status = solve(p, ONE)
        if status == FAILED:
            return wp.vec2d(_FAILED_MARGIN, ZERO)
        if status == FEASIBLE:
            balanced = ONE
    return wp.vec2d(low, balanced)


@wp.kernel
def margin_kernel(
    first: wp.int32,
    last: wp.int32,
    first_worker: wp.int32,
    stride: wp.int32,
    contact_point: wp.array(dtype=wp.vec3d),
    contact_normal: wp.array(dtype=wp.vec3d),
    contact_link: wp.array(dtype=wp.int32),
    contact_offset: wp.array(dtype=wp.int32),
    link_count: wp.array(dtype=wp.int32),
    support_point: wp.array(dtype=wp.vec3d),
    support_normal: wp.array(dtype=wp.vec3d),
    linear: wp.array(dtype=wp.vec3d),
    angular: wp.array(dtype=wp.vec3d),
    friction_hand: wp.float64,
    friction_environment: wp.float64,
    cap: wp.float64,
    memory: Memory,
    margin: wp.array(dtype=wp.float64),
    balanced: wp.array(dtype=wp.int32),
):
    """Solve problems first <= i < last with `stride` workers; i = configuration * twists + twist.

    Points are relative to the centre of mass, in half-lengths of the object; forces in weights. linear, angular: velocity
    of a point p is linear + angular x p, the object's fastest point moving at 1.
    """
    worker = first_worker + wp.tid()
    p = Program()
    p.edges = memory.edges[worker]
    p.normal = memory.normal[worker]
    p.friction = memory.friction[worker]
    p.key = memory.key[worker]
    p.key_value = memory.key_value[worker]
    p.key_price = memory.key_price[worker]
    p.basis = memory.basis[worker]
    p.value = memory.value[worker]
    p.inverse = memory.inverse[worker]
    p.scratch = memory.scratch[worker]
    p.cap = cap
    p.right_side = vec6(ZERO, ZERO, ONE, ZERO, ZERO, ZERO)
    index = first + wp.tid()
    while index < last:
        configuration = index // linear.shape[0]
        straight = linear[index % linear.shape[0]]
        turning = angular[index % linear.shape[0]]
        turns = wp.length(turning) > ZERO
        start = contact_offset[configuration]
        p.contacts = contact_offset[configuration + 1] - start
        p.links = link_count[configuration]
        p.edge_link = contact_link[start : start + p.contacts]
        for contact in range(p.contacts):
            normal = contact_normal[start + contact]
            point = contact_point[start + contact]
            motion = straight + wp.cross(turning, point)
            if turns:
                motion = wp.normalize(motion)
            tangent = first_tangent(normal, motion)
            for edge in range(EDGE_COUNT):
                force = cone_edge(normal, tangent, edge, friction_hand) - normal
                p.edges[contact * EDGE_COUNT + edge] = wrench(point, force)
        p.supports = wp.int32(0)
        blocked = wp.bool(False)
        for support in range(support_point.shape[0]):
            normal = support_normal[support]
            point = support_point[support]
            velocity = straight + wp.cross(turning, point)
            approach = wp.dot(normal, velocity)
            if wp.length(velocity) <= PIVOT_SPEED:
                tangent = first_tangent(-normal, wp.normalize(turning))
                for edge in range(EDGE_COUNT):
                    p.normal[p.supports] = wrench(point, normal)
                    p.friction[p.supports] = wrench(point, cone_edge(-normal, tangent, edge, friction_environment))
                    p.supports = p.supports + 1
            elif approach < -MOTION_TOLERANCE:
                blocked = wp.bool(True)
            elif approach <= MOTION_TOLERANCE:
                slip = wp.normalize(velocity - approach * normal)
                p.normal[p.supports] = wrench(point, normal)
                p.friction[p.supports] = wrench(point, -friction_environment * slip)
                p.supports = p.supports + 1
        result = wp.vec2d(ZERO, ZERO)
        if not blocked:
            result = search(p)
        margin[index] = result[0]
        balanced[index] = wp.int32(result[1])
        index += stride
