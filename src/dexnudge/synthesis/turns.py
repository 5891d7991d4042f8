"""How an object at rest on a plane can turn: in place, over an edge of its own, and over the edge of a table."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from dexnudge.dataset.schema import TURNS
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.scenes.motion import Turn, Twist
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import SupportContacts, support_contacts
from dexnudge.scenes.support_hull import hull_corners

UP = np.array([0.0, 0.0, 1.0])
HEADINGS = {"+x": (1.0, 0.0, 0.0), "+y": (0.0, 1.0, 0.0), "-x": (-1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0)}
FACING = np.cos(np.pi / 4)  # least cosine between a tip's heading and the outward normal of the edge that it goes over
TABLE_EDGE = 0.25  # where a table ends, from the centre of mass (0) to the object's farthest support (1)
FLAT = 1e-4  # [m] a corner of the supports' outline that stands out less is none


@dataclass(frozen=True)
class RestingTurn:
    """One of `TURNS`: the twist with which it begins, what then supports the object, and where a tip heads (else zeros).

    Frame: that of the scene.
    """

    twist: Twist
    supports: SupportContacts
    heading: Float[np.ndarray, "3"]


def resting_turns(scene: Scene) -> list[RestingTurn | None]:
    """Return each of `TURNS` for an object at rest on a plane; None where its supports have no edge on that side."""
    return [_turn(scene, *name.split()) for name in TURNS]


def _turn(scene: Scene, kind: str, way: str) -> RestingTurn | None:
    supports, centre = support_contacts(scene), sliding_task(scene).centre
    if kind == "turn":
        axis = UP if way == "+z" else -UP
        return RestingTurn(_twist(scene, axis, centre), supports, np.zeros(3))
    heading = np.array(HEADINGS[way])
    outline = supports.points[hull_corners(supports.points, UP, tolerance=FLAT)]
    ends = np.roll(outline, -1, axis=0)
    if kind == "edge":
        along = outline @ heading
        place = float(along.max() + (1 - TABLE_EDGE) * (centre @ heading - along.max()))
        on_table = _behind(outline, ends, heading, place)
        point = on_table[np.argmax(on_table @ heading)]
        supports = SupportContacts(points=on_table, normals=np.tile(UP, (len(on_table), 1)))
        return RestingTurn(_twist(scene, np.cross(UP, heading), point), supports, heading)
    outward = np.cross(ends - outline, UP)  # as long as the edge
    length = np.linalg.norm(outward, axis=1)
    widest = int(np.argmax(outward @ heading))
    if outward[widest] @ heading <= FACING * length[widest]:
        return None
    axis = np.cross(UP, outward[widest] / length[widest])
    return RestingTurn(_twist(scene, axis, outline[widest]), supports, heading)


def _twist(scene: Scene, axis: Float[np.ndarray, "3"], point: Float[np.ndarray, "3"]) -> Twist:
    return replace(scene, turn=Turn(1.0, axis, point), motion_length=0.0).object_motion.twist()


def _behind(
    outline: Float[np.ndarray, "corner 3"],
    ends: Float[np.ndarray, "corner 3"],
    heading: Float[np.ndarray, "3"],
    place: float,
) -> Float[np.ndarray, "kept 3"]:
    """Return the corners of the part of a convex outline up to `place` [m] along the heading, those of the cut included."""
    start, end = outline @ heading - place, ends @ heading - place
    cut = start * end < 0
    share = (start[cut] / (start[cut] - end[cut]))[:, None]
    return np.concatenate([outline[start <= 0], outline[cut] + share * (ends[cut] - outline[cut])])
