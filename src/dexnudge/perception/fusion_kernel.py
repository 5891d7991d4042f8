"""A depth image's local planes, and what they add to a grid of truncated signed distances: kernels in Warp."""

from dexnudge.geometry.warp_runtime import wp

MEASURED = wp.constant(1)  # kinds of pixels with depth; 0 = none
COMPLETED = wp.constant(2)
OF_OBJECT = wp.constant(3)
SURE = wp.constant(0.01)  # [px^4] determinant of a window's moments: pixels that are not in a row have more


@wp.func
def known_in_window(depth: wp.array2d(dtype=float), row: int, column: int, half: int):
    """Return how many pixels around one have depth, and the nearest depth."""
    known = float(0.0)
    nearest = float(1.0e6)
    for i in range(wp.max(row - half, 0), wp.min(row + half + 1, depth.shape[0])):
        for j in range(wp.max(column - half, 0), wp.min(column + half + 1, depth.shape[1])):
            if depth[i, j] > 0.0:
                known += 1.0
                nearest = wp.min(nearest, depth[i, j])
    return known, nearest


@wp.func
def moments(
    depth: wp.array2d(dtype=float), kinds: wp.array2d(dtype=wp.uint8), row: int, column: int, half: int, last_kind: int
):
    """Return count, means of u, v, w, of uu, vv, ww, and of uv, uw, vw, and the inverse depth that w is taken about.

    u and v are taken about the pixel, w about one of the window's depths: single precision then loses nothing. `last_kind`:
    of the pixels that count.
    """
    about = float(0.0)
    n = float(0.0)
    sums = wp.vec3(0.0, 0.0, 0.0)
    squares = wp.vec3(0.0, 0.0, 0.0)
    products = wp.vec3(0.0, 0.0, 0.0)
    for i in range(wp.max(row - half, 0), wp.min(row + half + 1, depth.shape[0])):
        for j in range(wp.max(column - half, 0), wp.min(column + half + 1, depth.shape[1])):
            kind = int(kinds[i, j])
            if kind > 0 and kind <= last_kind:
                if about == 0.0:
                    about = 1.0 / depth[i, j]
                n += 1.0
                u = float(j - column)
                v = float(i - row)
                w = 1.0 / depth[i, j] - about
                sums += wp.vec3(u, v, w)
                squares += wp.vec3(u * u, v * v, w * w)
                products += wp.vec3(u * v, u * w, v * w)
    scale = 1.0 / wp.max(n, 1.0)
    return n, scale * sums, scale * squares, scale * products, about


@wp.func
def plane_of_moments(
    mean: wp.vec3,
    squares: wp.vec3,
    products: wp.vec3,
    about: float,
    column: float,
    row: float,
    intrinsics: wp.vec4,
    footprint: float,
    noise: wp.vec3,
    spread: float,
):
    """Return the plane and its cosine to the ray from what `moments` returns; cosine 0 if there is none.

    There is none where depth leaves the plane by more than `spread` times the camera's `noise` (`AXIAL_NOISE`), or by more
    than `footprint` [m] where that is more.
    """
    nothing = wp.vec4(0.0, 0.0, 0.0, 0.0)
    variances = squares - wp.cw_mul(mean, mean)
    uv = products[0] - mean[0] * mean[1]
    uw = products[1] - mean[0] * mean[2]
    vw = products[2] - mean[1] * mean[2]
    determinant = variances[0] * variances[1] - uv * uv
    if determinant < SURE:
        return nothing, 0.0
    slope_u = (variances[1] * uw - uv * vw) / determinant
    slope_v = (variances[0] * vw - uv * uw) / determinant
    value = about + mean[2] - slope_u * mean[0] - slope_v * mean[1]
    if value <= 0.0:
        return nothing, 0.0
    beyond = 1.0 / value - noise[2]
    tolerance = wp.max(spread * (noise[0] + noise[1] * beyond * beyond), footprint) * value * value
    if variances[2] - slope_u * uw - slope_v * vw > tolerance * tolerance:
        return nothing, 0.0
    x = column - intrinsics[2]
    y = row - intrinsics[3]
    normal = wp.vec3(intrinsics[0] * slope_u, intrinsics[1] * slope_v, value - x * slope_u - y * slope_v)
    size = wp.length(normal)
    cosine = value / (size * wp.length(wp.vec3(x / intrinsics[0], y / intrinsics[1], 1.0)))
    return wp.vec4(-normal[0], -normal[1], -normal[2], 1.0) / size, cosine


@wp.kernel
def fit_planes(
    depth: wp.array2d(dtype=float),
    kinds: wp.array2d(dtype=wp.uint8),
    intrinsics: wp.vec4,
    half: int,
    footprint: float,
    least_share: float,
    steepest: float,
    noise: wp.vec3,
    spread: float,
    planes: wp.array2d(dtype=wp.vec4),
    weights: wp.array2d(dtype=float),
    free: wp.array2d(dtype=float),
):
    """Fit w = 1 / z = a + b u + c v to the window around each pixel, one thread a pixel; see `LocalPlanes`.

    `kinds`: MEASURED, COMPLETED, OF_OBJECT, or 0. What was completed counts only where too little was measured.
    """
    row, column = wp.tid()
    weights[row, column] = 0.0
    free[row, column] = 0.0
    known, nearest = known_in_window(depth, row, column, half)
    least = least_share * float((2 * half + 1) * (2 * half + 1))
    if known < least:
        return
    if int(kinds[row, column]) == OF_OBJECT:
        free[row, column] = nearest
        return
    free[row, column] = nearest - footprint
    kind = MEASURED
    n, mean, squares, products, about = moments(depth, kinds, row, column, half, kind)
    if n < least:
        kind = COMPLETED
        n, mean, squares, products, about = moments(depth, kinds, row, column, half, kind)
    if n < least:
        return
    plane, cosine = plane_of_moments(
        mean, squares, products, about, float(column), float(row), intrinsics, footprint, noise, spread
    )
    if cosine >= steepest:
        planes[row, column] = plane
        weight = cosine * n / float((2 * half + 1) * (2 * half + 1))
        weights[row, column] = wp.where(kind == COMPLETED, -weight, weight)


@wp.kernel
def integrate(
    planes: wp.array2d(dtype=wp.vec4),
    weights: wp.array2d(dtype=float),
    free: wp.array2d(dtype=float),
    intrinsics: wp.vec4,
    origin: wp.vec3,
    axes: wp.mat33,
    truncation: float,
    behind: wp.vec2,
    assumed_weight: float,
    free_weight: float,
    sums: wp.array3d(dtype=float),
    totals: wp.array3d(dtype=float),
    guesses: wp.array3d(dtype=float),
):
    """Add the evidence of a view (`LocalPlanes`) along the third axis of the grid, one thread a column.

    `origin`: node (0, 0, 0) in the camera frame [m]; columns of `axes`: from a node to the next along each axis [m];
    `intrinsics`: fx, fy, cx, cy. A weight falls to 0 from `behind[0]` to `behind[1]` [m] behind the surface.
    """
    i, j = wp.tid()
    start = origin + axes * wp.vec3(float(i), float(j), 0.0)
    step = axes * wp.vec3(0.0, 0.0, 1.0)
    height = weights.shape[0]
    width = weights.shape[1]
    for k in range(sums.shape[2] - 2):
        at = start + float(k) * step
        if at[2] > 0.001:
            u = intrinsics[0] * at[0] / at[2] + intrinsics[2] + 0.5
            v = intrinsics[1] * at[1] / at[2] + intrinsics[3] + 0.5
            if u >= 0.0 and v >= 0.0 and u < float(width) and v < float(height):
                row = int(v)
                column = int(u)
                weight = weights[row, column]
                value = float(0.0)
                if weight != 0.0:
                    plane = planes[row, column]
                    distance = plane[0] * at[0] + plane[1] * at[1] + plane[2] * at[2] + plane[3]
                    guess = weight < 0.0
                    weight = wp.abs(weight)
                    if guess:
                        weight = assumed_weight * weight
                    value = wp.min(distance / truncation, 1.0)
                    if distance < -behind[0]:
                        weight = wp.max(weight * (behind[1] + distance) / (behind[1] - behind[0]), 0.0)
                    if guess and guesses.shape[0] > 0:
                        guesses[i + 1, j + 1, k + 1] = guesses[i + 1, j + 1, k + 1] + weight
                elif at[2] < free[row, column]:
                    weight = free_weight
                    value = 1.0
                if weight > 0.0:
                    sums[i + 1, j + 1, k + 1] = sums[i + 1, j + 1, k + 1] + weight * value
                    totals[i + 1, j + 1, k + 1] = totals[i + 1, j + 1, k + 1] + weight
