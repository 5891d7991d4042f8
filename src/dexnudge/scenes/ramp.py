"""`ramp`: on a slope of 15 degrees, to be pushed down it."""

from __future__ import annotations

import numpy as np
import trimesh

from dexnudge.scenes.resting import place_at_rest
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.table import place_near_edge, slab

SLOPE = np.radians(15.0)  # tan = 0.27, below the default friction of 0.4: the object stays where it is


def ramp(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """The table tilted by 15 deg about a horizontal axis, so that the edge which the motion heads for is the lowest.

    Any yaw, 0.10 to 0.30 m from that edge; motion straight down the slope, in its plane.

    Raises:
        SceneError: the object is larger than the table allows.
    """
    resting = place_at_rest(mesh, generator.uniform(-np.pi, np.pi))
    (x, y), motion, drawn = place_near_edge(resting.size, generator)
    # The axis for which a positive turn lowers the side that the motion heads for.
    tilt = trimesh.transformations.rotation_matrix(SLOPE, np.cross([0.0, 0.0, 1.0], motion))
    environment = slab()
    environment.apply_transform(tilt)
    parameters = {"yaw": resting.yaw, **drawn, "slope_degrees": float(np.degrees(SLOPE))}
    return Scene(mesh, environment, tilt @ resting.at(x, y), tilt[:3, :3] @ motion, name="ramp", parameters=parameters)
