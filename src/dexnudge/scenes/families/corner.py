"""`corner`: pushed into the corner of two walls, to be pulled out along their bisector."""

from __future__ import annotations

import numpy as np
import trimesh

from dexnudge.errors import SceneError
from dexnudge.scenes.boxes import box, joined
from dexnudge.scenes.families.table import SLAB, slab
from dexnudge.scenes.resting import place_at_rest
from dexnudge.scenes.scene import Scene

WALL = 0.02  # [m] thickness
WALL_HEIGHT = (0.10, 0.20)  # [m]
GAP = (0.0, 0.005)  # [m] from the object to each wall
LIP = 0.002  # [m] of the walls over the table's rim; see `shelf.LIP`


def corner(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Walls along the table's -x and -y edges; long side along one of them, 0 to 5 mm from both; motion (1, 1, 0).

    Raises:
        SceneError: the object and its way out do not fit on the table.
    """
    resting = place_at_rest(mesh, float(generator.integers(4)) * np.pi / 2)
    gap_x, gap_y = (float(gap) for gap in generator.uniform(*GAP, size=2))
    height = float(generator.uniform(*WALL_HEIGHT))
    length, width = float(resting.size[0]), float(resting.size[1])
    if max(length, width) + GAP[1] + WALL > SLAB[1]:
        raise SceneError(
            f"the object covers {length:.3f} x {width:.3f} m; expected at most {SLAB[1] - GAP[1] - WALL:.3f} m a side "
            "for the corner of the table; use a smaller object or your own environment"
        )
    x, y = -SLAB[0] / 2 + WALL, -SLAB[1] / 2 + WALL  # the inner faces of the walls
    environment = joined(
        [
            slab(),
            box((x - WALL - LIP, y - WALL - LIP, 0.0), (x, SLAB[1] / 2 + LIP, height)),
            box((x, y - WALL - 2 * LIP, 0.0), (SLAB[0] / 2 + LIP, y, height + LIP)),
        ]
    )
    pose = resting.at(x + gap_x + length / 2, y + gap_y + width / 2)
    parameters = {"yaw": resting.yaw, "gap_x": gap_x, "gap_y": gap_y, "wall_height": height}
    return Scene(mesh, environment, pose, np.array([1.0, 1.0, 0.0]), name="corner", parameters=parameters)
