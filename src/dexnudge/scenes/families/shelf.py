"""`shelf`: in a cell open in front, to be pulled out; `deep`: in a low cell, far behind the opening."""

from __future__ import annotations

import numpy as np
import trimesh

from dexnudge.errors import SceneError
from dexnudge.scenes.boxes import box, joined
from dexnudge.scenes.resting import RestingObject, place_at_rest
from dexnudge.scenes.scene import Scene

DEPTH = 0.30  # [m] inside, from the opening to the back wall
WALL = 0.018  # [m] a common chipboard
WIDTH = (0.28, 0.40)  # [m] inside
HEIGHT = (0.16, 0.24)  # [m] inside
LIP = 0.002  # [m] by which boards stand out over each other: no two boxes share a corner, so each stays closed
FRONT_GAP = (0.010, 0.060)  # [m] from the opening back to the object's front end
DEEP_HEIGHT = (0.12, 0.16)  # [m] inside
DEEP_FRONT_GAP = (0.08, 0.18)  # [m] from the opening back to the object's front end
YAW = np.radians(30.0)  # largest turn of the long side from the motion
WALL_GAP = 0.005  # [m] least distance to the side and back walls
HEAD_ROOM = 0.06  # [m] least height above the object: a finger is 20 mm thick
DRAWS = 20  # yaws tried before the object is laid straight, then across


def shelf(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Cell 0.28-0.40 wide, 0.16-0.24 high; object 10 to 60 mm behind the front edge; motion +x, out."""
    return in_cell("shelf", mesh, generator, height=HEIGHT, front_gap=FRONT_GAP)


def deep(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Cell 0.12-0.16 high; object 0.08 to 0.18 m behind the front edge, as far as it fits; motion +x, out."""
    return in_cell("deep", mesh, generator, height=DEEP_HEIGHT, front_gap=DEEP_FRONT_GAP)


def in_cell(
    name: str,
    mesh: trimesh.Trimesh,
    generator: np.random.Generator,
    *,
    height: tuple[float, float],
    front_gap: tuple[float, float],
) -> Scene:
    """The opening is the plane x = 0, the floor z = 0; the cell lies behind it, closed on five sides.

    The cell is drawn high enough for the object and a finger above it. The long side is within 30 deg of the
    motion; where the object does not fit so, straight, then across.

    Raises:
        SceneError: the object does not fit in any of these ways, or leaves no room above for a finger.
    """
    sizes = place_at_rest(mesh, 0.0).size
    lowest = max(height[0], float(sizes[2]) + HEAD_ROOM)
    inner_width = generator.uniform(*WIDTH)
    inner_height = lowest + generator.uniform() * max(height[1] - lowest, 0.0)
    flip = float(generator.integers(2)) * np.pi
    yaws = [*(generator.uniform(-YAW, YAW, size=DRAWS) + flip), flip, np.pi / 2]
    fraction_gap, fraction_side = (float(draw) for draw in generator.uniform(size=2))
    resting = _first_that_fits(mesh, yaws, inner_width, front_gap[0])
    if resting is None or lowest > height[1]:
        raise SceneError(
            f"the object lies {sizes[0]:.3f} x {sizes[1]:.3f} m and {sizes[2]:.3f} m high; expected one that fits "
            f"{DEPTH - front_gap[0] - WALL_GAP:.3f} x {inner_width - 2 * WALL_GAP:.3f} m, at most "
            f"{height[1] - HEAD_ROOM:.3f} m high, in the cell of {name!r}; use a smaller object or your own environment"
        )
    deepest = min(front_gap[1], DEPTH - WALL_GAP - float(resting.size[0]))
    gap = front_gap[0] + fraction_gap * (deepest - front_gap[0])
    side = (fraction_side - 0.5) * (inner_width - 2 * WALL_GAP - float(resting.size[1]))
    pose = resting.at(-gap - resting.size[0] / 2, side)
    parameters = {
        "yaw": resting.yaw,
        "inner_width": inner_width,
        "inner_height": inner_height,
        "front_gap": gap,
        "sideways": side,
    }
    return Scene(
        mesh, cell(inner_width, inner_height), pose, np.array([1.0, 0.0, 0.0]), name=name, parameters=parameters
    )


def cell(width: float, height: float) -> trimesh.Trimesh:
    """Floor, ceiling, two sides and a back, five closed boxes around the inside [m]."""
    side, y, x = width / 2, width / 2 + WALL + LIP, -DEPTH
    return joined(
        [
            box((x, -y, -WALL), (0.0, y, 0.0)),
            box((x, -y, height), (0.0, y, height + WALL)),
            box((x, -side - WALL, 0.0), (0.0, -side, height)),
            box((x, side, 0.0), (0.0, side + WALL, height)),
            box((x - WALL, -y - LIP, -WALL - LIP), (x, y + LIP, height + WALL + LIP)),
        ]
    )


def _first_that_fits(mesh: trimesh.Trimesh, yaws: list[float], width: float, front_gap: float) -> RestingObject | None:
    for yaw in yaws:
        resting = place_at_rest(mesh, yaw)
        if resting.size[0] <= DEPTH - front_gap - WALL_GAP and resting.size[1] <= width - 2 * WALL_GAP:
            return resting
    return None
