"""`edge`: flat on a table, partly over its edge, to be tipped over it: pressed down in front, its back rises."""

from __future__ import annotations

import numpy as np
import trimesh

from dexnudge.errors import SceneError
from dexnudge.scenes.asked_turn import over_foremost
from dexnudge.scenes.families.table import EDGES, SIDE_GAP, SLAB, slab
from dexnudge.scenes.resting import place_at_rest
from dexnudge.scenes.scene import Scene

OVERHANG = (0.35, 0.45)  # of the object's length along the motion
YAW = np.radians(15.0)  # largest turn of the long side from the motion
CARRIED = 0.05  # of that length by which the centre of mass is at least behind the edge
ANGLE = np.radians([20.0, 35.0])  # of the tip


def edge(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Long side within 15 deg of the motion, 35 to 45 % of it over the table's edge; tipped by 20 to 35 deg, no slide.

    Raises:
        SceneError: its centre of mass would not be behind the edge, or it does not fit beside it.
    """
    drawn = EDGES[generator.integers(4)]
    axis, sign = (0 if drawn[1] == "x" else 1), (1.0 if drawn[0] == "+" else -1.0)
    motion = np.zeros(3)
    motion[axis] = sign
    flip = float(generator.integers(2)) * np.pi
    resting = place_at_rest(mesh, axis * np.pi / 2 + flip + generator.uniform(-YAW, YAW))
    overhang, sideways, angle = generator.uniform(*OVERHANG), generator.uniform(-0.5, 0.5), generator.uniform(*ANGLE)
    length, across = float(resting.size[axis]), float(resting.size[1 - axis])
    free = SLAB[1 - axis] - across - 2 * SIDE_GAP
    place = np.zeros(2)
    place[axis] = sign * (SLAB[axis] / 2 + (overhang - 0.5) * length)
    place[1 - axis] = sideways * free
    parameters = {
        "yaw": resting.yaw,
        "edge": drawn,
        "overhang": overhang * length,
        "tip_degrees": float(np.degrees(angle)),
    }
    scene = Scene(mesh, slab(), resting.at(*place), motion, name="edge", parameters=parameters)
    scene = over_foremost(scene, angle, 0.0)
    assert scene.turn is not None
    behind = float((scene.turn.point - scene.centre_of_mass) @ motion)
    if behind < CARRIED * length or free < 0:
        raise SceneError(
            f"the object is {across:.3f} m wide and its centre of mass {1e3 * behind:.0f} mm behind the edge; expected at "
            f"most {across + free:.3f} m and at least {1e3 * CARRIED * length:.0f} mm; use another object or seed"
        )
    return scene
