"""`turn`: flat on a table, to be turned in place by a right angle, either way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from dexnudge.scenes.families.table import place_near_edge, slab
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.resting import place_at_rest
from dexnudge.scenes.scene import Scene

ANGLE = np.pi / 2  # [rad]


def turn(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """As `table`, the circle around it 0.10 to 0.30 m from an edge; about the vertical through its centre of mass."""
    resting = place_at_rest(mesh, generator.uniform(-np.pi, np.pi))
    around = np.full(2, float(np.linalg.norm(resting.size[:2])))
    (x, y), motion, drawn = place_near_edge(around, generator)
    axis = np.array([0.0, 0.0, 1.0 if generator.integers(2) else -1.0])
    parameters = {"yaw": resting.yaw, **drawn, "turn_degrees": float(axis[2] * np.degrees(ANGLE))}
    scene = Scene(mesh, slab(), resting.at(x, y), motion, name="turn", parameters=parameters)
    return replace(scene, turn=Turn(ANGLE, axis, scene.centre_of_mass), motion_length=0.0)
