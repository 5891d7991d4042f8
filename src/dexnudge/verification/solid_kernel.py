"""The Warp kernels that look for a hand's points in solids, and for points of a surface in a hand's links.

A thread has one hand and one solid. What a known distance d at c says of a point p (distances to a closed surface are
1-Lipschitz): there it is between d - |p - c| and d + |p - c|. So most points need no query, and most others no sign.
Whatever is left out is less deep than what is known already.
"""

# Warp's annotations are values, not types.
# mypy: ignore-errors

from dexnudge.geometry.exact_distance import closed_nearest, signed_nearest, surface_nearest
from dexnudge.geometry.warp_runtime import wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

ROUNDING = wp.constant(wp.float64(1.0e-5))
"""Distances in single precision differ from true ones by less, some metres from a mesh's centre [m]."""
FAR = wp.constant(wp.float64(1.0e3))
NOTHING = wp.constant(wp.float64(0.0))


@wp.struct
class Solid:
    """A mesh that is asked about its own centre; see `SolidDistance`."""

    mesh: wp.uint64
    origin: wp.vec3d
    low: wp.vec3  # bounds about `origin` [m]
    high: wp.vec3
    hole: wp.float64
    closed: wp.bool  # whether it has neither holes nor triangles that disagree about the outside


@wp.struct
class Nodes:
    """A `PointTree` in the order in which it is walked."""

    point: wp.array(dtype=wp.vec3d)  # link frame [m]
    radius: wp.array(dtype=wp.float64)
    after: wp.array(dtype=int)
    first: wp.array(dtype=int)  # (link + 1,)


@wp.struct
class Hits:
    """Points within reach of a solid, a row for each hand; `count` may be more than there is room for."""

    count: wp.array(dtype=int)
    node: wp.array2d(dtype=int)
    distance: wp.array2d(dtype=float)
    closest: wp.array2d(dtype=wp.vec3)
    face: wp.array2d(dtype=int)


@wp.struct
class Surface:
    """Triangles on which points are looked for: their corners [m], the same in their own planes, their bounds in a tree."""

    bounds: wp.uint64  # about `origin`
    origin: wp.vec3d
    corner: wp.array2d(dtype=wp.vec3d)
    flat: wp.array2d(dtype=wp.vec2d)
    spacing: wp.float64


@wp.struct
class Known:
    """The signed distance of a solid at one place, and the least that it must be elsewhere to have that sign there."""

    centre: wp.vec3d
    distance: wp.float64
    least: wp.float64


@wp.struct
class Link:
    """The solid that a thread looks for a surface's points in, and the frame of that."""

    solid: Solid
    extent: wp.array(dtype=wp.float64)  # half-spaces that hold it, see `Solids`
    middle: wp.vec3d  # of its box, link frame
    half: wp.vec3d
    centre: wp.vec3d  # the same in the surface's frame
    axes: wp.mat33d  # rows
    known_depth: wp.float64


@wp.func
def least_distance(known: Known, p: wp.vec3d) -> wp.float64:
    """Return what the signed distance at p is at least [m]."""
    result = known.distance - wp.length(p - known.centre)
    if result < known.least:
        result = -FAR
    return result


@wp.func
def known_at(solid: Solid, p: wp.vec3d, distance: wp.float64) -> Known:
    """Return the signed distance at p as known. Through a hole the sign may change as far from the surface as it is wide."""
    result = Known()
    result.centre = p
    result.distance = distance
    result.least = solid.hole
    if solid.closed:
        result.least = -FAR
    return result


@wp.func
def nothing_known() -> Known:
    """Return what says nothing of any place."""
    result = Known()
    result.least = FAR
    return result


@wp.func
def found_distance(solid: Solid, p: wp.vec3d, known: Known, limit: wp.float64):
    """Return (signed distance, closest point, face) at p [m]; beyond `limit` the distance may be infinite."""
    local = wp.vec3(p - solid.origin)
    if least_distance(known, p) > ROUNDING or outside_box(solid, p, ROUNDING):
        distance, closest, face = surface_nearest(solid.mesh, local, float(limit + ROUNDING))
        return distance, closest, face
    if solid.closed:
        distance, closest, face = closed_nearest(solid.mesh, local, solid.low, solid.high)
        return distance, closest, face
    distance, closest, face = signed_nearest(solid.mesh, local, solid.low, solid.high)
    return distance, closest, face


@wp.func
def outside_box(solid: Solid, p: wp.vec3d, reach: wp.float64) -> wp.bool:
    """Return whether p is farther than `reach` [m] from the bounds of a solid along some axis."""
    local = p - solid.origin
    result = wp.bool(False)
    for axis in range(3):
        if local[axis] < wp.float64(solid.low[axis]) - reach or local[axis] > wp.float64(solid.high[axis]) + reach:
            result = True
    return result


@wp.func
def beyond(
    extents: wp.array2d(dtype=wp.float64), directions: wp.array(dtype=wp.vec3d), s: int, p: wp.vec3d, reach: wp.float64
) -> wp.bool:
    """Return whether p is farther than `reach` [m] from some half-space that holds solid s."""
    result = wp.bool(False)
    for k in range(extents.shape[1]):
        if wp.dot(directions[k], p) > extents[s, k] + reach:
            result = True
            break
    return result


@wp.func
def keep(hits: Hits, i: int, node: int, distance: float, closest: wp.vec3, face: int):
    """Keep a hit of hand i, where there is room."""
    place = hits.count[i]
    hits.count[i] = place + 1
    if place < hits.node.shape[1]:
        hits.node[i, place] = node
        hits.distance[i, place] = distance
        hits.closest[i, place] = closest
        hits.face[i, place] = face


@wp.func
def placed(T: wp.mat44d, q: wp.vec3d) -> wp.vec3d:
    """Return a point moved by a rigid transform."""
    return wp.vec3d(
        T[0, 0] * q[0] + T[0, 1] * q[1] + T[0, 2] * q[2] + T[0, 3],
        T[1, 0] * q[0] + T[1, 1] * q[1] + T[1, 2] * q[2] + T[1, 3],
        T[2, 0] * q[0] + T[2, 1] * q[1] + T[2, 2] * q[2] + T[2, 3],
    )


@wp.kernel
def points_in_solids(
    first: int,
    nodes: Nodes,
    T_frame_link: wp.array2d(dtype=wp.mat44d),
    T_solid_frame: wp.array2d(dtype=wp.mat44d),
    solids: wp.array(dtype=Solid),
    extents: wp.array2d(dtype=wp.float64),
    directions: wp.array(dtype=wp.vec3d),
    asked: wp.array2d(dtype=int),
    reach: wp.float64,
    only_deeper: wp.bool,
    hits: Hits,
    deepest: wp.array(dtype=wp.float64),
):
    """Look for the points of one hand, of the links that are asked for, in one solid grown by `reach` [m].

    Either all of them are kept as hits, or only_deeper: `deepest` is raised, and points that cannot raise it are left out.
    """
    i, s = wp.tid()
    i = i + first
    solid = solids[s]
    known = nothing_known()
    for link in range(asked.shape[1]):
        if asked[s, link] == 0:
            continue
        T = T_solid_frame[i % T_solid_frame.shape[0], s] * T_frame_link[i, link]
        node = nodes.first[link]
        while node < nodes.first[link + 1]:
            p = placed(T, nodes.point[node])
            radius = nodes.radius[node]
            bound = reach + radius
            if only_deeper:
                bound = bound - deepest[i]
            # Nothing is inside beyond the box; near a hole it may be deeper than its way to the box or a half-space.
            holed = bound + solid.hole
            far = outside_box(solid, p, wp.min(reach + radius, holed) + ROUNDING)
            far = far or beyond(extents, directions, s, p, holed + ROUNDING)
            if radius > NOTHING:
                bound = holed
            if far or least_distance(known, p) > bound + ROUNDING:
                node = nodes.after[node]
                continue
            distance, closest, face = found_distance(solid, p, known, bound)
            apart = wp.float64(distance)
            if only_deeper:
                if reach - apart > deepest[i]:
                    wp.atomic_max(deepest, i, reach - apart)
            elif apart <= reach:
                keep(hits, i, node, distance, closest, face)
            if apart > bound + ROUNDING:
                node = nodes.after[node]
                continue
            if radius > NOTHING:
                known = known_at(solid, p, apart)
            node = node + 1


@wp.func
def raise_depth(
    link: Link,
    directions: wp.array(dtype=wp.vec3d),
    p: wp.vec3d,
    clearance: wp.float64,
    known: Known,
    i: int,
    deepest: wp.array(dtype=wp.float64),
) -> Known:
    """Raise the depth of hand i to that of a surface's point p in a link grown by `clearance`; return what is known then."""
    local = link.middle + link.axes * (p - link.centre)
    for k in range(directions.shape[0]):
        if link.extent[k] - wp.dot(directions[k], local) + clearance <= link.known_depth:
            return known
    limit = clearance - deepest[i]
    if outside_box(link.solid, local, wp.max(limit, NOTHING) + ROUNDING):
        return known
    if least_distance(known, local) > limit + ROUNDING:
        return known
    distance, _closest, _face = found_distance(link.solid, local, known, limit)
    apart = wp.float64(distance)
    if clearance - apart > deepest[i]:
        wp.atomic_max(deepest, i, clearance - apart)
    if apart < FAR:
        return known_at(link.solid, local, apart)
    return known


@wp.func
def clipped(link: Link, start: wp.vec3d, along: wp.vec3d, low: wp.float64, high: wp.float64) -> wp.vec2d:
    """Return the part from `low` to `high` of the line start + t along that is in the link's box, a little more."""
    p = link.axes * (start - link.centre)
    d = link.axes * along
    enter = low
    leave = high
    for axis in range(3):
        if wp.abs(d[axis]) > wp.float64(1.0e-12):
            one = (-link.half[axis] - p[axis]) / d[axis]
            other = (link.half[axis] - p[axis]) / d[axis]
            enter = wp.max(enter, wp.min(one, other))
            leave = wp.min(leave, wp.max(one, other))
        elif wp.abs(p[axis]) > link.half[axis] + ROUNDING:
            leave = enter - FAR
    return wp.vec2d(enter, leave)


@wp.func
def holds(surface: Surface, face: int, u: wp.float64, v: wp.float64) -> wp.bool:
    """Return whether a place in the plane of a triangle is in it, its border included."""
    a = surface.flat[face, 0]
    b = surface.flat[face, 1]
    c = surface.flat[face, 2]
    result = (b[0] - a[0]) * (v - a[1]) - (b[1] - a[1]) * (u - a[0]) >= NOTHING
    result = result and (c[0] - b[0]) * (v - b[1]) - (c[1] - b[1]) * (u - b[0]) >= NOTHING
    result = result and (a[0] - c[0]) * (v - c[1]) - (a[1] - c[1]) * (u - c[0]) >= NOTHING
    return result and (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > NOTHING


@wp.func
def unit(a: wp.vec3d) -> wp.vec3d:
    """Return a vector of unit length; zeros for zeros."""
    length = wp.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    result = wp.vec3d()
    if length > NOTHING:
        result = a / length
    return result


@wp.kernel
def surface_in_solids(
    first: int,
    surface: Surface,
    T_frame_solid: wp.array2d(dtype=wp.mat44d),
    solids: wp.array(dtype=Solid),
    extents: wp.array2d(dtype=wp.float64),
    directions: wp.array(dtype=wp.vec3d),
    clearance: wp.float64,
    deepest: wp.array(dtype=wp.float64),
):
    """Raise the depth of one hand to that of the points of `surface_lattice` in one of its solids grown by `clearance`."""
    i, s = wp.tid()
    i = i + first
    T = T_frame_solid[i, s]
    link = Link()
    link.solid = solids[s]
    link.extent = extents[s]
    link.middle = link.solid.origin
    link.half = wp.float64(0.5) * wp.vec3d(link.solid.high - link.solid.low)
    link.half = link.half + wp.vec3d(clearance + ROUNDING, clearance + ROUNDING, clearance + ROUNDING)
    link.axes = wp.mat33d(T[0, 0], T[1, 0], T[2, 0], T[0, 1], T[1, 1], T[2, 1], T[0, 2], T[1, 2], T[2, 2])
    link.centre = wp.transpose(link.axes) * link.middle + wp.vec3d(T[0, 3], T[1, 3], T[2, 3])
    link.known_depth = deepest[i]
    reach = wp.vec3d()
    for axis in range(3):
        for own in range(3):
            reach[axis] = reach[axis] + link.half[own] * wp.abs(link.axes[own, axis])
    known = nothing_known()
    face = wp.int32(0)
    middle = link.centre - surface.origin
    near = wp.bvh_query_aabb(surface.bounds, wp.vec3(middle - reach), wp.vec3(middle + reach))
    while wp.bvh_query_next(near, face):
        origin = surface.corner[face, 0]
        meets = wp.bool(True)
        for k in range(directions.shape[0]):
            along = wp.transpose(link.axes) * directions[k]
            room = link.extent[k] - wp.dot(directions[k], link.middle) + wp.dot(along, link.centre)
            least = wp.min(
                wp.dot(along, origin),
                wp.min(wp.dot(along, surface.corner[face, 1]), wp.dot(along, surface.corner[face, 2])),
            )
            if room - least + clearance <= link.known_depth:
                meets = False
                break
        if not meets:
            continue
        edge = surface.corner[face, 1] - origin
        normal = wp.cross(edge, surface.corner[face, 2] - origin)
        e_u = unit(edge)
        e_v = unit(wp.cross(normal, edge))
        a = surface.flat[face, 0]
        b = surface.flat[face, 1]
        c = surface.flat[face, 2]
        u_middle = wp.dot(e_u, link.centre - origin)
        u_reach = wp.dot(
            link.half,
            wp.vec3d(
                wp.abs(wp.dot(link.axes[0], e_u)), wp.abs(wp.dot(link.axes[1], e_u)), wp.abs(wp.dot(link.axes[2], e_u))
            ),
        )
        column = wp.ceil(wp.max(wp.min(a[0], wp.min(b[0], c[0])), u_middle - u_reach) / surface.spacing)
        last_column = wp.floor(wp.min(wp.max(a[0], wp.max(b[0], c[0])), u_middle + u_reach) / surface.spacing)
        v_low = wp.min(a[1], wp.min(b[1], c[1]))
        v_high = wp.max(a[1], wp.max(b[1], c[1]))
        while column <= last_column:
            u = surface.spacing * column
            part = clipped(link, origin + u * e_u, e_v, v_low, v_high)
            row = wp.ceil((part[0] - ROUNDING) / surface.spacing)
            while row <= (part[1] + ROUNDING) / surface.spacing:
                v = surface.spacing * row
                if holds(surface, face, u, v):
                    known = raise_depth(link, directions, origin + (u * e_u + v * e_v), clearance, known, i, deepest)
                row = row + wp.float64(1.0)
            column = column + wp.float64(1.0)
        for k in range(3):
            start = surface.corner[face, k]
            along = surface.corner[face, (k + 1) % 3] - start
            length = wp.sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2])
            parts = wp.max(wp.ceil(length / surface.spacing), wp.float64(1.0))
            span = clipped(link, start, along, NOTHING, wp.float64(1.0))
            place = wp.max(wp.ceil((span[0] - ROUNDING) * parts), NOTHING)
            while place <= wp.min((span[1] + ROUNDING) * parts, parts):
                p = start + place / parts * along
                known = raise_depth(link, directions, p, clearance, known, i, deepest)
                place = place + wp.float64(1.0)
