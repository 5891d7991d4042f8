"""Trilinear lookup in packed distance grids, as a Warp function for CPU and CUDA."""

from collections.abc import Sequence

import numpy as np

from dexnudge.geometry.distance_grid import DistanceGrid
from dexnudge.geometry.warp_runtime import wp

EDGE = 1.0e-4  # [cells] keeps the upper corner of a lookup inside the grid
HALF_DIAGONAL = wp.constant(0.8660254)  # [cells] most by which an interpolated value is under the exact distance
OVER_THE_BOX = wp.constant(1.4142136)  # slope outside the box, where distance to the box and value at it both change
NOTHING_NEAR = wp.constant(1.0e6)  # [m] least distance in a sphere that does not reach the grid's box


@wp.struct
class GridHeader:
    """Where one grid's values start in the packed array, and its box."""

    origin: wp.vec3
    cell: float
    nx: int
    ny: int
    nz: int
    start: int


@wp.struct
class PackedGrids:
    """Several grids in one flat array."""

    headers: wp.array(dtype=GridHeader)
    values: wp.array(dtype=float)


def pack_grids(grids: Sequence[DistanceGrid], *, device: str = "cpu") -> PackedGrids:
    """Copy grids into one flat array on the device, in order."""
    headers, flat, start = [], [], 0
    for grid in grids:
        header = GridHeader()
        header.origin = wp.vec3(*(float(v) for v in grid.origin))
        header.cell = grid.cell
        header.nx, header.ny, header.nz = grid.values.shape
        header.start = start
        headers.append(header)
        flat.append(grid.values.ravel())
        start += grid.values.size
    packed = PackedGrids()
    packed.headers = wp.array(headers, dtype=GridHeader, device=device)
    packed.values = wp.array(np.concatenate(flat, dtype=np.float32), dtype=float, device=device, copy=False)
    return packed


@wp.func
def inside_box(header: GridHeader, p: wp.vec3) -> bool:
    """Whether p lies in the grid's box."""
    g = (p - header.origin) / header.cell
    return (
        g[0] >= 0.0
        and g[1] >= 0.0
        and g[2] >= 0.0
        and g[0] <= float(header.nx - 1)
        and g[1] <= float(header.ny - 1)
        and g[2] <= float(header.nz - 1)
    )


@wp.func
def grid_distance(header: GridHeader, values: wp.array(dtype=float), p: wp.vec3) -> wp.vec4:
    """(distance [m], its gradient) at p."""
    inverse = 1.0 / header.cell
    g = (p - header.origin) * inverse
    gx = wp.clamp(g[0], 0.0, float(header.nx - 1) - EDGE)
    gy = wp.clamp(g[1], 0.0, float(header.ny - 1) - EDGE)
    gz = wp.clamp(g[2], 0.0, float(header.nz - 1) - EDGE)
    x = int(gx)
    y = int(gy)
    z = int(gz)
    fx = gx - float(x)
    fy = gy - float(y)
    fz = gz - float(z)
    sy = header.nz
    sx = header.ny * header.nz
    k = header.start + x * sx + y * sy + z
    c000 = values[k]
    c001 = values[k + 1]
    c010 = values[k + sy]
    c011 = values[k + sy + 1]
    c100 = values[k + sx]
    c101 = values[k + sx + 1]
    c110 = values[k + sx + sy]
    c111 = values[k + sx + sy + 1]
    c00 = c000 + fz * (c001 - c000)
    c01 = c010 + fz * (c011 - c010)
    c10 = c100 + fz * (c101 - c100)
    c11 = c110 + fz * (c111 - c110)
    c0 = c00 + fy * (c01 - c00)
    c1 = c10 + fy * (c11 - c10)
    distance = c0 + fx * (c1 - c0)
    dz0 = (c001 - c000) * (1.0 - fy) + (c011 - c010) * fy
    dz1 = (c101 - c100) * (1.0 - fy) + (c111 - c110) * fy
    gradient = inverse * wp.vec3(c1 - c0, (c01 - c00) * (1.0 - fx) + (c11 - c10) * fx, dz0 * (1.0 - fx) + dz1 * fx)
    beyond = p - (header.origin + header.cell * wp.vec3(gx, gy, gz))
    gap = wp.length(beyond)
    if gap > header.cell * 0.01:
        distance += gap
        gradient = beyond / gap
    return wp.vec4(distance, gradient[0], gradient[1], gradient[2])


@wp.func
def corner_distance(header: GridHeader, values: wp.array(dtype=float), p: wp.vec3) -> wp.vec2:
    """(lower bound of the exact distance at the point of the grid's box nearest to p, distance from p to that point) [m].

    One corner instead of eight: exact distances are 1-Lipschitz, so the bound is the nearest corner's less that far.
    """
    g = (p - header.origin) / header.cell
    inner = wp.vec3(
        wp.clamp(g[0], 0.0, float(header.nx - 1)),
        wp.clamp(g[1], 0.0, float(header.ny - 1)),
        wp.clamp(g[2], 0.0, float(header.nz - 1)),
    )
    x = int(inner[0] + 0.5)
    y = int(inner[1] + 0.5)
    z = int(inner[2] + 0.5)
    corner = values[header.start + (x * header.ny + y) * header.nz + z]
    way = wp.length(inner - wp.vec3(float(x), float(y), float(z)))
    return wp.vec2(corner - header.cell * way, header.cell * wp.length(g - inner))


@wp.func
def least_distance(header: GridHeader, values: wp.array(dtype=float), centre: wp.vec3, radius: float) -> float:
    """Lower bound [m] of the distances that the grid holds in its box and in a sphere.

    A point of both is within sqrt(radius^2 - gap^2) of the box's point nearest to the centre, `gap` being the distance from
    the centre to the box, because the box is convex.
    """
    found = corner_distance(header, values, centre)
    left = radius * radius - found[1] * found[1]
    if left < 0.0:
        return NOTHING_NEAR
    return found[0] - wp.sqrt(left) - HALF_DIAGONAL * header.cell


@wp.func
def least_distance_anywhere(header: GridHeader, values: wp.array(dtype=float), centre: wp.vec3, radius: float) -> float:
    """Lower bound [m] of what `grid_distance` gives in a sphere, in and outside the grid's box."""
    reach = wp.vec3(radius, radius, radius)
    fall = radius
    if not (inside_box(header, centre - reach) and inside_box(header, centre + reach)):
        fall = OVER_THE_BOX * radius
    found = corner_distance(header, values, centre)
    return found[0] + found[1] - fall - HALF_DIAGONAL * header.cell
