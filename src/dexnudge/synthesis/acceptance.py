"""How an object at rest can turn: in place, over an edge of its own or a table's; and which configurations are kept.

All must be free of penetration by exact distance, and touch. Then a push, press or hook needs a feasible force in some
planar direction, and a grasp must hold in physics.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float

from dexnudge.dataset.schema import INFEASIBLE, NUM_DIRECTIONS, TURNS, best_direction, direction_angles
from dexnudge.hands.batch import HandBatch
from dexnudge.hands.hand import Hand
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.fast_balance import force_margins
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.scenes.motion import Turn, Twist
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import SupportContacts, support_contacts
from dexnudge.scenes.support_hull import hull_corners
from dexnudge.simulation.hold import HoldTest
from dexnudge.verification.criteria import PENETRATION_LIMIT, SUCCESS_MARGIN
from dexnudge.verification.measurements import Measurements

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


PRESSING = 0.7  # mean vertical part of the contacts' normals above which a hand presses
PARTS = ("object", "environment", "self")  # that a hand may penetrate
FAR_BELOW = 5.0  # [m]
PLANE_SIDE, PLANE_DEPTH = 2.0, 0.5  # [m] a support so wide and deep that it has no other side


@dataclass(frozen=True)
class Verified:
    """Verdicts on n configurations in the resting frame.

    `direction_margin` (n, 16), `turn_margin` (n, 10): force margin per planar direction and per turn of `TURNS`, -1 where
    the forces do not suffice at all.
    `hold_translation` [m], `hold_rotation` [rad] (n): how far the object drifted in the hold test, NaN without one.
    `reason`: empty for what is kept, else why not.
    """

    reason: list[str]
    penetration: Float[np.ndarray, "n 3"]
    direction_margin: Float[np.ndarray, "n direction"]
    turn_margin: Float[np.ndarray, "n turn"]
    hold_translation: Float[np.ndarray, " n"]
    hold_rotation: Float[np.ndarray, " n"]
    contacts: list[HandContacts]
    hand: Hand

    @property
    def kept(self) -> Bool[np.ndarray, " n"]:
        """Which configurations are kept."""
        return np.asarray([not reason for reason in self.reason], dtype=bool)

    def columns(self, row: int) -> dict[str, Any]:
        """Return what a dataset stores of one verdict, by the names of `ConfigurationRow`; links ascending.

        contact_points: the mean of each link's contacts [m].
        """
        contacts = self.contacts[row]
        touching = np.unique(contacts.link)
        links = tuple(self.hand.link_names[link] for link in touching)
        means = [contacts.points[contacts.link == link].mean(axis=0) for link in touching]
        drift = {name: float(getattr(self, name)[row]) for name in ("hold_translation", "hold_rotation")}
        depths = zip(PARTS, self.penetration[row].tolist(), strict=True)
        return {
            "direction_margin": self.direction_margin[row],
            "turn_margin": self.turn_margin[row],
            "contact_links": links,
            "contact_points": np.asarray(means).reshape(-1, 3),
            "digits": tuple(sorted({digit for link in links if (digit := self.hand.digit_of_link[link]) is not None})),
            **{f"penetration_{part}": depth for part, depth in depths},
            **{name: None if np.isnan(value) else value for name, value in drift.items()},
        }


def geometry_reasons(
    depth: Float[np.ndarray, "n 3"], touches: Bool[np.ndarray, " n"], *, parts: tuple[str, ...], limit: float
) -> list[str]:
    """Return why each hand is rejected for its geometry, "" where it is not; depth [m] of each of `parts`."""
    deepest = [parts[index] for index in depth.argmax(axis=1)]
    outcomes = zip(deepest, depth.max(axis=1) > limit, touches, strict=True)
    return [f"penetration {part}" if deep else "" if touch else "no contact" for part, deep, touch in outcomes]


def resting_scene(object_mesh: trimesh.Trimesh) -> Scene:
    """Return the object (resting frame, metres) on a wide plane, with the default frictions and mass."""
    plane = trimesh.creation.box((PLANE_SIDE, PLANE_SIDE, PLANE_DEPTH))
    plane.apply_translation((0.0, 0.0, object_mesh.bounds[0, 2] - PLANE_DEPTH / 2))
    return Scene(object_mesh, plane, np.eye(4), np.asarray([1.0, 0.0, 0.0]), name="resting")


def floating_scene(object_mesh: trimesh.Trimesh) -> Scene:
    """Return the object in free space: its only surroundings lie far below."""
    scene = resting_scene(object_mesh)
    plane = scene.environment_mesh.copy()
    plane.apply_translation((0.0, 0.0, -FAR_BELOW))
    return replace(scene, environment_mesh=plane, name="floating")


class GraspVerifier:
    """Verifies grasps of one hand on one floating object: clean, touching, and holding against a pull from six sides.

    The hold test is DexGraspBench's, in MuJoCo: see `simulation.hold`.
    """

    def __init__(self, hand: Hand, scene: Scene) -> None:
        self._hand, self._scene = hand, scene
        self._hold = HoldTest(hand, scene.object_mesh)

    def __call__(self, q: Float[np.ndarray, "n coordinates"]) -> Verified:
        """Return the verdicts on grasps in the frame of the object's mesh."""
        verified = _clean(self._hand, self._scene, q)
        clean = np.flatnonzero(verified.kept)
        for row, held in zip(clean, self._hold(q[clean], [verified.contacts[row] for row in clean]), strict=True):
            verified.hold_translation[row], verified.hold_rotation[row] = held.translation, held.rotation
            verified.reason[row] = held.reason
        return verified


class NonPrehensileVerifier:
    """Verifies configurations of one hand against one object at rest on a plane."""

    def __init__(self, hand: Hand, scene: Scene) -> None:
        self._hand, self._scene = hand, scene
        self._supports, self._task = support_contacts(scene), sliding_task(scene)
        angles = direction_angles()
        directions = np.stack([np.cos(angles), np.sin(angles), np.zeros(NUM_DIRECTIONS)], axis=1)
        self._twists = [Twist(direction, np.zeros(3)) for direction in directions]
        self._turns = resting_turns(scene)

    def __call__(self, q: Float[np.ndarray, "n coordinates"]) -> Verified:
        """Return the verdicts on configurations in the resting frame."""
        verified = _clean(self._hand, self._scene, q)
        clean = np.flatnonzero(verified.kept)
        if len(clean):
            contacts = [verified.contacts[row] for row in clean]
            margins = force_margins(contacts, self._supports, self._task, twists=self._twists, threads=1)
            verified.direction_margin[clean] = np.where(margins.factor > 0, margins.factor, INFEASIBLE)
            verified.turn_margin[clean] = self.turn_margins(contacts)
        for row in clean:
            if max(verified.direction_margin[row].max(), verified.turn_margin[row].max()) < SUCCESS_MARGIN:
                verified.reason[row] = "force"
        return verified

    def turn_margins(self, contacts: list[HandContacts]) -> Float[np.ndarray, "n turn"]:
        """Return the force margins of the turns, -1 where the forces do not suffice or the object has no such edge."""
        found = np.full((len(contacts), len(TURNS)), INFEASIBLE)
        for index, turn in enumerate(self._turns):
            if turn is not None:
                margins = force_margins(contacts, turn.supports, self._task, twists=[turn.twist], threads=1)
                found[:, index] = np.where(margins.factor[:, 0] > 0, margins.factor[:, 0], INFEASIBLE)
        return found

    @property
    def turns(self) -> Float[np.ndarray, "turn 6"]:
        """Twist of each of `TURNS`: linear at the origin [m/m], angular [rad/m]; NaN where the object has no such edge."""
        twists = [turn and [*turn.twist.linear, *turn.twist.angular] for turn in self._turns]
        return np.array([twist or [np.nan] * 6 for twist in twists], dtype=np.float64)


def _clean(hand: Hand, scene: Scene, q: Float[np.ndarray, "n coordinates"]) -> Verified:
    """What both kinds of verification begin with: penetrations and contacts."""
    found = Measurements(HandBatch(hand, torch.as_tensor(q, dtype=torch.float64)), scene)
    depths = found.penetrations
    penetration = np.stack([depths.object, depths.environment, depths.self_collision], axis=1)
    touches = np.asarray([len(contacts.points) > 0 for contacts in found.contacts], dtype=bool)
    return Verified(
        reason=geometry_reasons(penetration, touches, parts=PARTS, limit=PENETRATION_LIMIT),
        penetration=penetration,
        direction_margin=np.full((len(q), NUM_DIRECTIONS), INFEASIBLE),
        turn_margin=np.full((len(q), len(TURNS)), INFEASIBLE),
        hold_translation=np.full(len(q), np.nan),
        hold_rotation=np.full(len(q), np.nan),
        contacts=found.contacts,
        hand=hand,
    )


def behaviour_of(
    contacts: HandContacts,
    direction_margin: Float[np.ndarray, " direction"],
    root: Float[np.ndarray, " 3"],
    turn_margin: Float[np.ndarray, " turn"],
) -> str:
    """Return the behaviour in the best direction of motion; of a hand that can only turn the object, in its best turn."""
    if direction_margin.max() < SUCCESS_MARGIN:
        way = TURNS[int(np.argmax(turn_margin))].split()[1]
        return behaviour_along(contacts, np.asarray(HEADINGS.get(way, (0.0, 0.0, 0.0))), root)
    angle = direction_angles()[best_direction(direction_margin)]
    return behaviour_along(contacts, np.asarray([np.cos(angle), np.sin(angle), 0.0]), root)


def behaviour_along(contacts: HandContacts, motion: Float[np.ndarray, " 3"], root: Float[np.ndarray, " 3"]) -> str:
    """Return push, press or hook, by where the contacts lie and from where the hand comes.

    press: the contacts' mean outward normal points up. Otherwise hook if the hand's root lies ahead of the object along
    the motion (it pulls), else push. root: from the object's middle [m].
    """
    if contacts.normals[:, 2].mean() > PRESSING:
        return "press"
    return "hook" if float(root @ motion) > 0 else "push"
