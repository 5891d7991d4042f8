"""Where rays first meet a mesh, on Warp's bounding-volume tree."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dexnudge.geometry.warp_runtime import wp
from dexnudge.jobs.processes import available_cores
from dexnudge.viewer.trace_kernel import first_hits_kernel

BANDS_PER_WORKER = 8  # so that workers that drew cheap rows help with the costly ones
SMALLEST_BAND = 4096  # below this the threads cost more than they bring


def parallel_launch(kernel: wp.Kernel, count: int, arguments: Sequence[Any]) -> None:
    """Launch `kernel` over `count` items in bands; its first parameter must be the index of the band's first item.

    Every item must write only its own outputs; then the result does not depend on the number of cores.
    """
    workers = available_cores()
    band = max(SMALLEST_BAND, -(-count // (workers * BANDS_PER_WORKER)))

    def launch(first: int) -> None:
        wp.launch(kernel, dim=min(band, count - first), inputs=[first, *arguments], device="cpu")

    launch(0)  # alone: the first launch compiles and loads the kernel, which threads must not do at the same time
    if count > band:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(launch, range(band, count, band)))


def warp_mesh(triangles: Float[np.ndarray, "face 3 3"]) -> wp.Mesh:
    """Return a tree over triangles given by their corners [m]; at least one."""
    points = np.ascontiguousarray(triangles, dtype=np.float32).reshape(-1, 3)
    return wp.Mesh(
        points=wp.array(points, dtype=wp.vec3, device="cpu"),
        indices=wp.array(np.arange(len(points), dtype=np.int32), dtype=wp.int32, device="cpu"),
    )


def first_hits(
    mesh: wp.Mesh, origins: Float[np.ndarray, "*_origins 3"], directions: Float[np.ndarray, "*rays 3"]
) -> tuple[Float[np.ndarray, "*rays"], Int[np.ndarray, "*rays"]]:
    """Return the distance along each ray [m] to the first triangle, and that triangle; 100 m and -1 where there is none.

    Args:
        mesh: as `warp_mesh` makes it.
        origins: where the rays start [m]; of the shape of `directions`, or one that NumPy broadcasts to it.
        directions: unit vectors.
    """
    shape, count = directions.shape[:-1], directions.size // 3
    distance, face = wp.empty(count, dtype=float, device="cpu"), wp.empty(count, dtype=int, device="cpu")
    if count:
        single = [np.broadcast_to(np.asarray(each, np.float32), directions.shape) for each in (origins, directions)]
        arrays = [wp.array(np.ascontiguousarray(each).reshape(-1, 3), dtype=wp.vec3, device="cpu") for each in single]
        parallel_launch(first_hits_kernel, count, [mesh.id, *arrays, distance, face])
    return distance.numpy().reshape(shape), face.numpy().reshape(shape)
