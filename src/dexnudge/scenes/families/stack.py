"""`stack`: on a pile of two books, to be pushed toward the nearest edge of the pile."""

from __future__ import annotations

import numpy as np
import trimesh

from dexnudge.scenes.boxes import box, joined
from dexnudge.scenes.families.table import place_near_edge, slab
from dexnudge.scenes.resting import place_at_rest
from dexnudge.scenes.scene import Scene

MARGIN = (0.005, 0.040)  # [m] by which the upper book stands out beyond the object, on each side by its own draw
LOWER_MARGIN = (0.005, 0.030)  # [m] by which the lower book stands out beyond the upper one
THICKNESS = (0.015, 0.040)  # [m] of a book


def stack(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Two closed books, a little larger than the object and straight, on a table; the books do not move.

    The object's long side is along x or y. Motion: toward the side of the upper book that is nearest.

    Raises:
        SceneError: the pile is larger than the table allows.
    """
    resting = place_at_rest(mesh, float(generator.integers(4)) * np.pi / 2)
    margins = generator.uniform(*MARGIN, size=4)  # -x, +x, -y, +y
    spread = generator.uniform(*LOWER_MARGIN, size=4)
    lower, upper = (float(value) for value in generator.uniform(*THICKNESS, size=2))
    half = resting.size[:2] / 2
    outer = margins + spread
    pile_size = np.array([2 * half[0] + outer[:2].sum(), 2 * half[1] + outer[2:].sum(), 0.0])
    (x, y), _, _ = place_near_edge(pile_size, generator)
    # (x, y) is the centre of the lower book; the object is off it by the difference of the margins.
    x, y = x + (outer[0] - outer[1]) / 2, y + (outer[2] - outer[3]) / 2

    def book(out: np.ndarray, low: float, high: float) -> trimesh.Trimesh:
        return box(
            (x - half[0] - out[0], y - half[1] - out[2], low), (x + half[0] + out[1], y + half[1] + out[3], high)
        )

    environment = joined([slab(), book(outer, 0.0, lower), book(margins, lower, lower + upper)])
    nearest = int(np.argmin(margins))
    motion = np.zeros(3)
    motion[nearest // 2] = 1.0 if nearest % 2 else -1.0
    parameters = {
        "yaw": resting.yaw,
        "margins": margins.tolist(),
        "lower_margins": outer.tolist(),
        "thickness_lower": lower,
        "thickness_upper": upper,
    }
    return Scene(mesh, environment, resting.at(x, y, lower + upper), motion, name="stack", parameters=parameters)
