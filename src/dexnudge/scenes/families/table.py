"""Families on a table. `table`: flat on it, near an edge, to be pushed toward that.

`ramp`: the same table, sloping down that way. `turn`: to be turned in place by a right angle, either way. `edge`: partly
over the edge, to be tipped over it: pressed down in front, its back rises. `corner`: pushed into the corner of two walls, to
be pulled out along their bisector. `stack`: on a pile of two books, to be pushed toward the nearest edge of the pile.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from dexnudge.errors import SceneError
from dexnudge.scenes.asked_turn import over_foremost
from dexnudge.scenes.boxes import box, joined
from dexnudge.scenes.families.shelf import LIP
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


QUARTER = np.pi / 2  # [rad]


def turn(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """As `table`, the circle around it 0.10 to 0.30 m from an edge; about the vertical through its centre of mass."""
    resting = place_at_rest(mesh, generator.uniform(-np.pi, np.pi))
    around = np.full(2, float(np.linalg.norm(resting.size[:2])))
    (x, y), motion, drawn = place_near_edge(around, generator)
    axis = np.array([0.0, 0.0, 1.0 if generator.integers(2) else -1.0])
    parameters = {"yaw": resting.yaw, **drawn, "turn_degrees": float(axis[2] * np.degrees(QUARTER))}
    scene = Scene(mesh, slab(), resting.at(x, y), motion, name="turn", parameters=parameters)
    return replace(scene, turn=Turn(QUARTER, axis, scene.centre_of_mass), motion_length=0.0)


OVERHANG = (0.35, 0.45)  # of the object's length along the motion
TIP_YAW = np.radians(15.0)  # largest turn of the long side from the motion
CARRIED = 0.05  # of that length by which the centre of mass is at least behind the edge
TIP = np.radians([20.0, 35.0])


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
    resting = place_at_rest(mesh, axis * np.pi / 2 + flip + generator.uniform(-TIP_YAW, TIP_YAW))
    overhang, sideways, angle = generator.uniform(*OVERHANG), generator.uniform(-0.5, 0.5), generator.uniform(*TIP)
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


WALL = 0.02  # [m] thickness
WALL_HEIGHT = (0.10, 0.20)  # [m]
WALL_GAP = (0.0, 0.005)  # [m] from the object to each wall


def corner(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Walls along the table's -x and -y edges; long side along one of them, 0 to 5 mm from both; motion (1, 1, 0).

    Raises:
        SceneError: the object and its way out do not fit on the table.
    """
    resting = place_at_rest(mesh, float(generator.integers(4)) * np.pi / 2)
    gap_x, gap_y = (float(gap) for gap in generator.uniform(*WALL_GAP, size=2))
    height = float(generator.uniform(*WALL_HEIGHT))
    length, width = float(resting.size[0]), float(resting.size[1])
    if max(length, width) + WALL_GAP[1] + WALL > SLAB[1]:
        raise SceneError(
            f"the object covers {length:.3f} x {width:.3f} m; expected at most {SLAB[1] - WALL_GAP[1] - WALL:.3f} m a side "
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
