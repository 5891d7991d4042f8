"""`drawer`: in a box open above, near one of its walls, to be moved away from that wall."""

from __future__ import annotations

import numpy as np
import trimesh

from dexnudge.errors import SceneError
from dexnudge.scenes.boxes import box, joined
from dexnudge.scenes.families.shelf import LIP
from dexnudge.scenes.resting import place_at_rest
from dexnudge.scenes.scene import MOTION_LENGTH, Scene

LENGTH = (0.38, 0.50)  # [m] inside, along the motion
WIDTH = (0.30, 0.45)  # [m] inside
HEIGHT = (0.08, 0.14)  # [m] of the walls above the floor
WALL = 0.015  # [m]
WALL_GAP = (0.010, 0.040)  # [m] from the object to the wall behind it
SIDE_GAP = 0.01  # [m] least distance to the side walls
YAW = np.radians(30.0)  # largest turn of the long side from the walls


def drawer(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Object 10 to 40 mm in front of the wall at -x, its way of 0.10 m free; motion +x, away from that wall.

    Raises:
        SceneError: the object and its way do not fit.
    """
    length, width, height = (float(generator.uniform(*limits)) for limits in (LENGTH, WIDTH, HEIGHT))
    yaw = float(generator.integers(4)) * np.pi / 2 + generator.uniform(-YAW, YAW)
    gap, sideways = float(generator.uniform(*WALL_GAP)), float(generator.uniform(-0.5, 0.5))
    room = (length - WALL_GAP[1] - MOTION_LENGTH, width - 2 * SIDE_GAP)
    for turned in (yaw, np.pi / 2, 0.0):
        resting = place_at_rest(mesh, turned)
        if resting.size[0] <= room[0] and resting.size[1] <= room[1]:
            break
    else:
        raise SceneError(
            f"the object lies {resting.size[0]:.3f} x {resting.size[1]:.3f} m; expected at most {room[0]:.3f} x "
            f"{room[1]:.3f} m in the drawer; use a smaller object or your own environment"
        )
    sideways *= room[1] - float(resting.size[1])
    pose = resting.at(-length / 2 + gap + float(resting.size[0]) / 2, sideways)
    parameters = {
        "yaw": resting.yaw,
        "inner_length": length,
        "inner_width": width,
        "wall_height": height,
        "wall_gap": gap,
        "sideways": sideways,
    }
    return Scene(
        mesh, open_box(length, width, height), pose, np.array([1.0, 0.0, 0.0]), name="drawer", parameters=parameters
    )


def open_box(length: float, width: float, height: float) -> trimesh.Trimesh:
    """A floor and four walls, five closed boxes around the inside [m]; the floor's top is z = 0."""
    x, y = length / 2, width / 2
    return joined(
        [
            box((-x - WALL - LIP, -y - WALL - LIP, -WALL), (x + WALL + LIP, y + WALL + LIP, 0.0)),
            box((-x - WALL, -y - WALL, 0.0), (-x, y + WALL, height)),
            box((x, -y - WALL, 0.0), (x + WALL, y + WALL, height)),
            box((-x, -y - WALL + LIP, 0.0), (x, -y, height - LIP)),
            box((-x, y, 0.0), (x, y + WALL - LIP, height - LIP)),
        ]
    )
