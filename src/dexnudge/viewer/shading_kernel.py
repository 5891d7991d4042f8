"""Warp kernels that light and shade a picture on the CPU."""

# mypy: ignore-errors
# Warp's declarations are values, not types, and what a kernel computes with is not what Python sees.
from dexnudge.geometry.warp_runtime import wp
from dexnudge.viewer.trace_kernel import FAR, STEP_ON, Geometry, Surface, View, ray_direction, trace

PATTERN = wp.constant(4)  # each block of 4 x 4 measured pixels has 16 sets of directions; windows of 4 x 4 average them
SHADOW_RAYS = wp.constant(5)  # for each measured pixel
AMBIENT_RAYS = wp.constant(8)  # for each measured pixel
AMBIENT_REACH = wp.constant(0.10)  # [m] farther things do not darken a surface
LIGHT_RADIUS = wp.constant(0.10)  # tangent of half the angle of the key light: soft shadow edges
SUBSAMPLES = wp.constant(8)  # rays for each pixel on an edge
OTHER_DEPTH = wp.constant(4.0e-3)  # [m] between neighbouring pixels of one surface there is less than this
OTHER_COVER = wp.constant(0.02)  # difference in opacity of what stands in front, above which there is an edge
OTHER_COLOUR = wp.constant(0.01)  # difference in linear colour, likewise
SAME_PLANE = wp.constant(2.0e-3)  # [m] pixels farther than this off the surface do not share their light
SAME_NORMAL = wp.constant(0.9)  # cosine, likewise
FEW = wp.constant(4.0)  # measured pixels on one surface in the small window, below which a larger one is taken
LOOKED_AROUND = PATTERN + 3  # measured pixels above and below one that shading may ask for


@wp.func
def shade(g: Geometry, view: View, s: Surface, direction: wp.vec3, key: float, ambient: float):
    """Lambert under a sky, a key light and a weak light at the camera, with a soft highlight."""
    n = s.normal
    facing = wp.max(0.0, wp.dot(n, view.light)) * key
    sky = wp.lerp(wp.vec3(0.34, 0.32, 0.30), wp.vec3(0.47, 0.50, 0.54), 0.5 + 0.5 * n[2])
    light = sky * ambient + wp.vec3(0.62, 0.60, 0.56) * facing
    light = light + wp.vec3(0.22) * (wp.abs(wp.dot(n, direction)) * (0.4 + 0.6 * ambient))
    half_way = wp.normalize(view.light - direction)
    shine = g.triangles[s.face].gloss * wp.pow(wp.max(0.0, wp.dot(n, half_way)), 40.0) * key
    return wp.cw_mul(g.triangles[s.face].colour, light) + wp.vec3(shine)


@wp.func
def background(view: View, y: float):
    """Light grey, darker towards the bottom."""
    return wp.lerp(wp.vec3(0.93, 0.945, 0.965), wp.vec3(0.70, 0.74, 0.79), y / float(view.height))


@wp.func
def colour_of(g: Geometry, view: View, s: Surface, direction: wp.vec3, y: float, key: float, ambient: float):
    """Linear colour at the end of a ray, with what covers it."""
    behind = background(view, y)
    if s.face >= g.first_marker:
        behind = shade(g, view, s, direction, 1.0, 1.0)
    elif s.face >= 0:
        behind = shade(g, view, s, direction, key, ambient)
    return s.cover + behind * (1.0 - s.opacity)


@wp.func
def around(normal: wp.vec3, x: float, y: float, z: float):
    """The vector (x, y, z) of a frame whose z axis is `normal`."""
    helper = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(normal[0]) > 0.7:
        helper = wp.vec3(0.0, 1.0, 0.0)
    a = wp.normalize(wp.cross(helper, normal))
    b = wp.cross(normal, a)
    return a * x + b * y + normal * z


@wp.func
def fraction(pattern: int, sample: int, base: float):
    """Two-dimensional low-discrepancy sequence (Roberts' R2 has these steps); the 16 patterns of a block interleave."""
    value = (float(sample * PATTERN * PATTERN + pattern) + 0.5) * base
    return value - wp.floor(value)


@wp.func
def unblocked(mesh: wp.uint64, point: wp.vec3, direction: wp.vec3, reach: float):
    """1 where nothing stands within `reach` in a direction, else 0."""
    if wp.mesh_query_ray_anyhit(mesh, point, direction, reach):
        return 0.0
    return 1.0


@wp.struct
class Pixels:
    """Of each pixel's centre: the surface that a ray through it meets, and the light there (key, ambient) if measured.

    Only `rows` rows are kept: each takes the place of the row so many above it.
    """

    surface: wp.array(dtype=Surface)
    light: wp.array(dtype=wp.vec2)
    rows: int


@wp.func
def kept_at(view: View, pixels: Pixels, x: int, y: int):
    """Where a pixel is kept."""
    return y % pixels.rows * view.width + x


@wp.kernel(enable_backward=False)
def trace_picture(first: int, top: int, g: Geometry, view: View, pixels: Pixels):
    """One ray through each pixel's centre from row `top` on, then shadow and ambient rays from where it ends."""
    x = (wp.tid() + first) % view.width
    y = (wp.tid() + first) // view.width + top
    i = kept_at(view, pixels, x, y)
    direction = ray_direction(view, float(x) + 0.5, float(y) + 0.5)
    s = trace(g, view.position, direction)
    pixels.surface[i] = s
    pixels.light[i] = wp.vec2(1.0, 1.0)
    if s.face < 0 or s.face >= g.first_marker or x % view.grid != 0 or y % view.grid != 0:
        return
    point = view.position + direction * s.depth - direction * STEP_ON + s.normal * (2.0 * STEP_ON)
    pattern = (x // view.grid % PATTERN) * PATTERN + (y // view.grid % PATTERN)
    key = float(0.0)
    if wp.dot(s.normal, view.light) > 0.0:
        for k in range(SHADOW_RAYS):
            radius = wp.sqrt(fraction(pattern, k, 0.7548776662)) * LIGHT_RADIUS
            angle = 6.2831853 * fraction(pattern, k, 0.5698402910)
            aim = wp.normalize(around(view.light, radius * wp.cos(angle), radius * wp.sin(angle), 1.0))
            key = key + unblocked(g.casting, point, aim, FAR) / float(SHADOW_RAYS)
    ambient = float(0.0)
    for k in range(AMBIENT_RAYS):
        square = fraction(pattern, k, 0.7548776662)
        angle = 6.2831853 * fraction(pattern, k, 0.5698402910)
        radius = wp.sqrt(square)
        aim = around(s.normal, radius * wp.cos(angle), radius * wp.sin(angle), wp.sqrt(1.0 - square))
        ambient = ambient + unblocked(g.blocking, point, aim, AMBIENT_REACH) / float(AMBIENT_RAYS)
    pixels.light[i] = wp.vec2(key, ambient)


@wp.func
def gather_light(view: View, pixels: Pixels, s: Surface, point: wp.vec3, x: int, y: int, reach: int):
    """Mean light of a window of 2 `reach` measured pixels a side, of those that lie on the surface of `s` at `point`.

    The third component is how many these are.
    """
    total = wp.vec2(0.0, 0.0)
    weight = float(0.0)
    middle_row = (y + view.grid // 2) // view.grid
    middle_column = (x + view.grid // 2) // view.grid
    for grid_row in range(middle_row - reach, middle_row + reach):
        for grid_column in range(middle_column - reach, middle_column + reach):
            row = grid_row * view.grid
            column = grid_column * view.grid
            if row >= 0 and row < view.height and column >= 0 and column < view.width:
                j = kept_at(view, pixels, column, row)
                other = pixels.surface[j]
                if other.face >= 0 and wp.dot(other.normal, s.normal) > SAME_NORMAL:
                    there = view.position + ray_direction(view, float(column) + 0.5, float(row) + 0.5) * other.depth
                    if wp.abs(wp.dot(there - point, s.normal)) < SAME_PLANE:
                        total = total + pixels.light[j]
                        weight = weight + 1.0
    if weight == 0.0:
        own = pixels.light[kept_at(view, pixels, x, y)]
        return wp.vec3(own[0], own[1], 0.0)
    total = total / weight
    return wp.vec3(total[0], total[1], weight)


@wp.kernel(enable_backward=False)
def shade_picture(first: int, top: int, g: Geometry, view: View, pixels: Pixels, colour: wp.array(dtype=wp.vec3)):
    """The colour of each pixel from row `top` on: one ray where all is even, several where there is an edge."""
    i = wp.tid() + first
    x = i % view.width
    y = i // view.width + top
    here = pixels.surface[kept_at(view, pixels, x, y)]
    edge = bool(False)
    for k in range(4):
        column = wp.clamp(x + (k % 2) * (2 * (k // 2) - 1), 0, view.width - 1)
        row = wp.clamp(y + ((k + 1) % 2) * (2 * (k // 2) - 1), 0, view.height - 1)
        other = pixels.surface[kept_at(view, pixels, column, row)]
        differs = (here.face < 0) != (other.face < 0) or wp.abs(here.opacity - other.opacity) > OTHER_COVER
        if not differs and here.face >= 0 and here.face != other.face:
            bends = wp.dot(here.normal, other.normal) < SAME_NORMAL or wp.abs(here.depth - other.depth) > OTHER_DEPTH
            differs = bends or wp.length(g.triangles[here.face].colour - g.triangles[other.face].colour) > OTHER_COLOUR
        if differs:
            edge = True
    count = int(1)  # noqa: RUF046 (Warp: this declares a variable)
    if edge:
        count = SUBSAMPLES
    total = wp.vec3(0.0)
    for k in range(count):
        px = float(x) + 0.5
        py = float(y) + 0.5
        if edge:
            # Eight rooks: no two subsamples share a row or a column of the pixel.
            px = float(x) + (float(k) + 0.5) / float(SUBSAMPLES)
            py = float(y) + (float((5 * k + 2) % SUBSAMPLES) + 0.5) / float(SUBSAMPLES)
        direction = ray_direction(view, px, py)
        s = here
        if edge:
            s = trace(g, view.position, direction)
        shared = wp.vec3(1.0)
        if s.face >= 0 and s.face < g.first_marker:
            point = view.position + direction * s.depth
            shared = gather_light(view, pixels, s, point, x, y, PATTERN // 2)
            if shared[2] < FEW:
                shared = gather_light(view, pixels, s, point, x, y, PATTERN + 2)
        total = total + wp.min(colour_of(g, view, s, direction, py, shared[0], shared[1]), wp.vec3(1.0))
    colour[i] = total / float(count)
