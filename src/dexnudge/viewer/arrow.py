"""The arrow that shows in which direction the object shall move."""

import numpy as np
import trimesh
from jaxtyping import Float

LENGTH_RANGE = (0.05, 0.12)  # [m] short enough to stay in the picture, long enough to read
LENGTH_PER_EXTENT = 0.6  # of the object's longest side
GAP = 0.004  # [m] between the object's leading edge and the arrow
THICKNESS = 0.005  # [m] thinner than any object that we handle, so that it does not sink into the table
SHAFT_WIDTH, HEAD_WIDTH, HEAD_LENGTH = 0.16, 0.42, 0.40  # of the arrow's length
UPRIGHT = 0.99  # |cosine| from which a motion counts as vertical


def motion_arrow(object_points: Float[np.ndarray, "n 3"], motion: Float[np.ndarray, "3"]) -> trimesh.Trimesh:
    """A flat solid arrow along `motion` from the leading edge of `object_points`, at the height of their middle.

    Args:
        object_points: vertices of the object [m], world frame.
        motion: unit direction, world frame.
    """
    helper = np.array([1.0, 0.0, 0.0]) if abs(motion[2]) > UPRIGHT else np.array([0.0, 0.0, 1.0])
    across = np.cross(helper, motion)
    across /= np.linalg.norm(across)
    normal = np.cross(motion, across)
    low, high = object_points.min(axis=0), object_points.max(axis=0)
    length = float(np.clip(LENGTH_PER_EXTENT * (high - low).max(), *LENGTH_RANGE))
    middle = (low + high) / 2
    start = middle + motion * (float(((object_points - middle) @ motion).max()) + GAP)

    shaft, head, neck = SHAFT_WIDTH / 2 * length, HEAD_WIDTH / 2 * length, (1 - HEAD_LENGTH) * length
    outline = np.array(
        [[0, -shaft], [neck, -shaft], [neck, -head], [length, 0], [neck, head], [neck, shaft], [0, shaft]]
    )
    flat = [[0, 1, 5], [0, 5, 6], [1, 2, 3], [1, 3, 5], [5, 3, 4]]
    count = len(outline)
    top = np.column_stack([outline, np.full(count, THICKNESS / 2)])
    bottom = np.column_stack([outline, np.full(count, -THICKNESS / 2)])
    sides = []
    for here in range(count):
        there = (here + 1) % count
        sides += [[here + count, there + count, there], [here + count, there, here]]
    lids = [[a, b, c] for a, b, c in flat] + [[a + count, c + count, b + count] for a, b, c in flat]
    local = np.concatenate([top, bottom])
    vertices = start + local @ np.stack([motion, across, normal])
    return trimesh.Trimesh(vertices, np.array(lids + sides), process=False)
