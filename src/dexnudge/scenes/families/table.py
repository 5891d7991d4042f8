"""`table`: flat on a table, near an edge, to be pushed toward it.

`ramp`: the same table, sloping down that way. `turn`: to be turned in place by a right angle, either way.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from dexnudge.errors import SceneError
from dexnudge.scenes.boxes import box
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.resting import place_at_rest
from dexnudge.scenes.scene import Scene

SLAB = (1.2, 0.8, 0.04)  # [m] length, width, thickness; the top is z = 0, centred on the origin
EDGE_GAP = (0.10, 0.30)  # [m] from the object to the edge that it is pushed toward
SIDE_GAP = 0.02  # [m] least distance from the object to the other edges
EDGES = ("+x", "-x", "+y", "-y")


def slab() -> trimesh.Trimesh:
    """The table top: its upper face is z = 0."""
    return box((-SLAB[0] / 2, -SLAB[1] / 2, -SLAB[2]), (SLAB[0] / 2, SLAB[1] / 2, 0.0))


def place_near_edge(
    size: np.ndarray, generator: np.random.Generator
) -> tuple[tuple[float, float], np.ndarray, dict[str, float | str]]:
    """Draw an edge and a place near it for a bounding box of `size` [m].

    Returns the centre (x, y), the motion toward the edge (3,), and the parameters drawn.

    Raises:
        SceneError: the object is larger than the table allows.
    """
    edge = EDGES[generator.integers(4)]
    axis, sign = (0 if edge[1] == "x" else 1), (1.0 if edge[0] == "+" else -1.0)
    gap = generator.uniform(*EDGE_GAP)
    free_across = SLAB[1 - axis] - size[1 - axis] - 2 * SIDE_GAP
    if SLAB[axis] - size[axis] - EDGE_GAP[1] < SIDE_GAP or free_across < 0:
        raise SceneError(
            f"the object covers {size[0]:.3f} x {size[1]:.3f} m; expected one that leaves {EDGE_GAP[1]:.2f} m to an "
            f"edge of the {SLAB[0]:g} x {SLAB[1]:g} m table; use a smaller object or your own environment"
        )
    centre = np.zeros(2)
    centre[axis] = sign * (SLAB[axis] / 2 - gap - size[axis] / 2)
    centre[1 - axis] = generator.uniform(-0.5, 0.5) * free_across
    motion = np.zeros(3)
    motion[axis] = sign
    return (float(centre[0]), float(centre[1])), motion, {"edge": edge, "edge_gap": gap}


def table(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Any yaw, 0.10 to 0.30 m from the object's nearest point to an edge; motion straight toward that edge."""
    resting = place_at_rest(mesh, generator.uniform(-np.pi, np.pi))
    (x, y), motion, drawn = place_near_edge(resting.size, generator)
    return Scene(mesh, slab(), resting.at(x, y), motion, name="table", parameters={"yaw": resting.yaw, **drawn})


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
