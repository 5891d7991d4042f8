"""Rays through a visual scene on the CPU: Warp functions and what they read."""

import numpy as np
from jaxtyping import Float

from dexnudge.geometry.warp_runtime import wp

# mypy: ignore-errors
# Warp's declarations are values, not types, and what a kernel computes with is not what Python sees.

FAR = wp.constant(100.0)  # [m] beyond every scene
STEP_ON = wp.constant(1.0e-4)  # [m] a ray starts again this far behind or above a surface
MAX_PANES = wp.constant(8)  # surfaces of glass that a ray may pass
HIDDEN_MARKER = wp.constant(0.55)  # opacity of a contact behind something


@wp.struct
class Triangle:
    """Corners [m, world] and the normals there, row by row, linear colour, strength of the highlight, opacity of glass."""

    corners: wp.mat33
    normals: wp.mat33
    colour: wp.vec3
    gloss: float
    opacity: float


TRIANGLE = Triangle.numpy_dtype()


@wp.struct
class Geometry:
    """What the camera sees, in one table of triangles: solids, then glass, then markers; and what blocks light.

    Each group has a tree, by its number; 0 for none. `blocking` is not in the table: it also holds the walls that face away
    from the camera. `casting` blocks the key light: object, hand and arrow, but no walls, or the inside of a shelf would
    lie in the dark.
    """

    solid: wp.uint64
    blocking: wp.uint64
    casting: wp.uint64
    glass: wp.uint64
    markers: wp.uint64
    first_glass: int
    first_marker: int
    triangles: wp.array(dtype=Triangle)


@wp.struct
class View:
    """Camera (right and up already scaled by the angle of view), picture size, and the direction to the key light.

    `grid`: pixels between those whose light is measured; the others share it.
    """

    position: wp.vec3
    right: wp.vec3
    up: wp.vec3
    forward: wp.vec3
    light: wp.vec3
    width: int
    height: int
    grid: int


@wp.struct
class Surface:
    """What a ray met: the solid or marker that ends it, and what covers that (colour times opacity, opacity)."""

    face: int
    depth: float
    normal: wp.vec3
    cover: wp.vec3
    opacity: float


@wp.func
def ray_direction(view: View, x: float, y: float):
    """Unit direction through a place in the picture: x pixels from the left, y from the top."""
    return wp.normalize(
        view.forward + view.right * (2.0 * x / float(view.width) - 1.0) + view.up * (1.0 - 2.0 * y / float(view.height))
    )


@wp.func
def smooth_normal(g: Geometry, face: int, u: float, v: float, direction: wp.vec3):
    """The normal between a triangle's corners, turned against the ray."""
    corners = g.triangles[face].normals
    n = wp.normalize(corners[0] * u + corners[1] * v + corners[2] * (1.0 - u - v))
    if wp.dot(n, direction) > 0.0:
        n = -n
    return n


@wp.func
def trace(g: Geometry, origin: wp.vec3, direction: wp.vec3):
    """What a ray meets, and what covers it: glass, and contacts that show through what hides them."""
    s = Surface()
    s.face = -1
    s.depth = FAR
    s.normal = -direction
    hit = wp.mesh_query_ray(g.solid, origin, direction, FAR)
    if hit.result:
        s.face = hit.face
        s.depth = hit.t
        s.normal = smooth_normal(g, hit.face, hit.u, hit.v, direction)
    marker_opacity = float(0.0)
    marker_colour = wp.vec3(0.0)
    if g.markers != wp.uint64(0):
        mark = wp.mesh_query_ray(g.markers, origin, direction, FAR)
        if mark.result:
            face = g.first_marker + mark.face
            normal = smooth_normal(g, face, mark.u, mark.v, direction)
            if mark.t < s.depth:
                s.face = face
                s.depth = mark.t
                s.normal = normal
            else:
                marker_opacity = HIDDEN_MARKER
                marker_colour = g.triangles[face].colour * (0.4 + 0.6 * wp.abs(wp.dot(normal, direction)))
    through = float(1.0)
    if g.glass != wp.uint64(0):
        passed = float(0.0)
        for _ in range(MAX_PANES):
            pane = wp.mesh_query_ray(g.glass, origin + direction * passed, direction, s.depth - passed)
            if not pane.result:
                break
            face = g.first_glass + pane.face
            s.cover = s.cover + g.triangles[face].colour * (through * g.triangles[face].opacity)
            through = through * (1.0 - g.triangles[face].opacity)
            passed = passed + pane.t + STEP_ON
    s.cover = s.cover + marker_colour * (through * marker_opacity)
    s.opacity = 1.0 - through * (1.0 - marker_opacity)
    return s


def warp_mesh(triangles: Float[np.ndarray, "face 3 3"]) -> wp.Mesh:
    """Return a tree over triangles given by their corners [m]; at least one."""
    points = np.ascontiguousarray(triangles, dtype=np.float32).reshape(-1, 3)
    return wp.Mesh(
        points=wp.array(points, dtype=wp.vec3, device="cpu", copy=False),
        indices=wp.array(np.arange(len(points), dtype=np.int32), dtype=wp.int32, device="cpu", copy=False),
    )
