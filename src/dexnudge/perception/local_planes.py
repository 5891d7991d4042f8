"""The surface at each pixel of a depth image: a plane fitted to the pixels around it.

In image coordinates the inverse depth of a plane is linear: w = 1 / z = a + b u + c v. A least-squares fit of it over a
small window averages the noise away, bridges pixels that dropped out, gives the normal, and tells where depth jumps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from dexnudge.geometry.warp_runtime import wp
from dexnudge.perception.depth_view import AXIAL_NOISE, DepthView
from dexnudge.perception.fusion_kernel import COMPLETED, MEASURED, OF_OBJECT, fit_planes

LARGEST_FIT = 4_000_000  # pixels; larger images are thinned, which bounds memory and time
WIDEST_WINDOW = 8  # pixels to each side: more would take longer and show nothing that a voxel could
LEAST_SHARE = 0.3  # of a window that must be measured: a pixel that dropped out is bridged, a hole is not
STEEPEST = 0.15  # cosine between surface and ray, 81 degrees: flatter ones are noise or an edge
SPREAD = 3.0  # standard deviations of the camera's noise by which depth may leave the plane before it is an edge


@dataclass(frozen=True, eq=False)
class LocalPlanes:
    """What a depth image says of surface and free space; camera frame.

    `planes`: unit normal n toward the camera and offset c [m]: n @ x + c is the distance before the surface. `weights`:
    cosine between normal and ray times the share of the window that is measured, 0 where there is no surface, negative
    where its depth was assumed. `free`: depth [m] up
    to which nothing stands where there is no surface, 0 = not known. `intrinsics`: fx, fy, cx, cy [px] of these arrays.
    """

    planes: Float[np.ndarray, "height width 4"]
    weights: Float[np.ndarray, "height width"]
    free: Float[np.ndarray, "height width"]
    intrinsics: Float[np.ndarray, "4"]


def local_planes(view: DepthView, *, footprint: float) -> LocalPlanes:
    """Fit a plane at each pixel over a window of about `footprint` [m] on the surface.

    Pixels of the object (`mask`, unless their depth is `assumed`) give no surface, but what is before them is free. Where
    depth jumps within the window there is no surface either, and what is a footprint before the nearest pixel is free.
    """
    step = int(np.ceil(np.sqrt(view.depth.size / LARGEST_FIT)))
    depth = np.ascontiguousarray(view.depth[::step, ::step])
    intrinsics = np.asarray([view.fx, view.fy, view.cx, view.cy]) / step
    kinds = np.ascontiguousarray(_kinds(view)[::step, ::step])
    middle = np.median(depth[depth > 0]) if depth.any() else 1.0
    half = int(np.clip(np.rint(0.5 * footprint * intrinsics[:2].min() / middle), 1, WIDEST_WINDOW))
    planes = wp.empty(depth.shape, dtype=wp.vec4, device="cpu")
    weights, free = (wp.empty(depth.shape, dtype=float, device="cpu") for _ in range(2))
    given = [wp.array(values, dtype=kind, device="cpu") for values, kind in ((depth, float), (kinds, wp.uint8))]
    inputs = [*given, wp.vec4(*intrinsics), half, footprint, LEAST_SHARE, STEEPEST, wp.vec3(*AXIAL_NOISE), SPREAD]
    wp.launch(fit_planes, dim=depth.shape, inputs=inputs, outputs=[planes, weights, free], device="cpu")
    return LocalPlanes(planes.numpy(), weights.numpy(), free.numpy(), intrinsics)


def _kinds(view: DepthView) -> UInt8[np.ndarray, "height width"]:
    """Return what each pixel's depth is."""
    kinds = np.where(view.measured, MEASURED, 0).astype(np.uint8)
    if view.mask is not None:
        kinds[view.measured & view.mask] = OF_OBJECT
    if view.assumed is not None:
        kinds[view.measured & view.assumed] = COMPLETED
    return kinds
