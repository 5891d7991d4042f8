"""What is to be seen of one configuration: parts with their poses, contact points, the motion.

Pictures and pages both take a `VisualScene`, so neither knows hands or scenes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError
from dexnudge.geometry.coarsening import thinned
from dexnudge.geometry.surface_lattice import faces_near
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import visual_meshes
from dexnudge.scenes.boxes import joined
from dexnudge.scenes.scene import Scene

Role = Literal[
    "object",
    "environment",
    "assumed",
    "unseen",
    "base",
    "link",
    "fingertip",
    "arm",
    "glass",
    "contact",
    "arrow",
    "support",
    "obstacle",
    "ghost",
]
SHOWN = 1.0  # [m] of a large scan beside object and motion that picture and page show
LARGE = 100_000  # triangles from which only the neighbourhood is shown, thinned
SURROUNDINGS: tuple[Role, ...] = ("environment", "assumed", "unseen")  # measured or given, completed, never seen

ROBOT: tuple[Role, ...] = ("base", "arm")  # what carries a hand
SEE_THROUGH: tuple[Role, ...] = (*SURROUNDINGS, *ROBOT)  # glass where they hide object or hand

Colour = tuple[float, float, float]  # sRGB, 0..1
PALETTE: dict[Role, Colour] = {
    "object": (0.94, 0.42, 0.16),
    "environment": (0.87, 0.84, 0.79),
    "assumed": (0.66, 0.76, 0.62),
    "unseen": (0.50, 0.51, 0.56),
    "base": (0.80, 0.82, 0.85),
    "link": (0.74, 0.77, 0.81),
    "fingertip": (0.36, 0.62, 0.82),
    "arm": (0.82, 0.83, 0.86),
    "glass": (0.76, 0.82, 0.90),
    "contact": (1.00, 0.87, 0.10),
    "arrow": (0.10, 0.60, 0.38),
    "support": (0.16, 0.38, 0.86),
    "obstacle": (0.85, 0.10, 0.16),
    "ghost": (0.94, 0.42, 0.16),  # the object's own: it is glass
}
LEGEND: dict[Role, str] = {
    "object": "object",
    "ghost": "where the object comes (see-through)",
    "fingertip": "fingertips",
    "base": "forearm",
    "contact": "contacts (balls)",
    "arrow": "motion (arrows)",
    "environment": "surroundings",
    "assumed": "assumed surroundings",
    "unseen": "not seen",
}
GHOST_TINT = 0.45  # of its colour, in legends; the rest is white
CONTACT_RADIUS = 0.0035  # [m] of the ball that stands for a contact
CREASE_ANGLE = 35.0  # [deg] two triangles that bend more than this keep their own normals

LENGTH_RANGE = (0.05, 0.12)  # [m] of the arrow: short enough to stay in the picture, long enough to read
LENGTH_PER_EXTENT = 0.6  # of the object's longest side
GAP = 0.004  # [m] between the object's leading edge and the arrow
THICKNESS = 0.005  # [m] thinner than any object that we handle, so that it does not sink into the table
SHAFT_WIDTH, HEAD_WIDTH, HEAD_LENGTH = 0.16, 0.42, 0.40  # of the arrow's length
UPRIGHT = 0.99  # |cosine| from which a motion counts as vertical
ARC_RADIUS, ARC_GAP = 0.002, 0.008  # [m] of the round arrow of a turn, and from the object's farthest point
ARC_PIECES = 24  # straight ones, of which it consists
STATIONS = 61  # of the motion, between which a page's slider leads


@dataclass(frozen=True, eq=False)
class Part:
    """One body: `mesh` [m] in its own frame, `T_world_part` (4, 4), what it is, and its sRGB colour if not the role's."""

    name: str
    role: Role
    mesh: trimesh.Trimesh
    T_world_part: Float[np.ndarray, "4 4"]
    own_colour: Colour | None = None

    @property
    def colour(self) -> Colour:
        """Its own colour, or that of its role."""
        return self.own_colour or PALETTE[self.role]

    def vertices_in_world(self) -> Float[np.ndarray, "n 3"]:
        """Return the vertices [m], world frame."""
        return trimesh.transform_points(self.mesh.vertices, self.T_world_part)

    def mesh_in_world(self) -> trimesh.Trimesh:
        """Return the mesh [m], world frame; as many vertices and triangles in the same order."""
        return trimesh.Trimesh(self.vertices_in_world(), self.mesh.faces, process=False)


@dataclass(frozen=True, eq=False)
class VisualScene:
    """One configuration in its scene.

    Attributes:
        parts: object, environment and links; parts without triangles are left out. Of a hand alone: its links.
        contacts: points where hand and object touch [m], world frame.
        motion: unit direction in which the object shall move, world frame; zero where it shall not, as in a grasp.
        motion_length: how far [m].
        arrow_length: of the arrow that shows the motion [m]; of a length that reads well unless given,
            none where it is 0.
        arrow_from: pose of the object (4, 4) at whose leading edge it starts; that of the object unless given.
        stations: of an object that turns: how far it is, in words, and its displacement (4, 4) then, from beginning to end.

    Raises:
        InputError: no part is an object or belongs to a hand.
    """

    parts: tuple[Part, ...]
    contacts: Float[np.ndarray, "n 3"]
    motion: Float[np.ndarray, "3"]
    motion_length: float = 0.10
    arrow_length: float | None = None
    arrow_from: Float[np.ndarray, "4 4"] | None = None
    stations: tuple[tuple[str, Float[np.ndarray, "4 4"]], ...] = ()

    def __post_init__(self) -> None:
        if not self.with_role("object", "link", "fingertip"):
            raise InputError(
                "a visual scene needs a part with the role 'object', 'link' or 'fingertip'; expected one or more, got none"
            )

    def with_role(self, *roles: Role) -> tuple[Part, ...]:
        """Return the parts that have one of these roles."""
        return tuple(part for part in self.parts if part.role in roles)

    def vertices(self, *roles: Role) -> Float[np.ndarray, "n 3"]:
        """Return the vertices of the parts that have one of these roles [m], world frame."""
        return np.concatenate([np.zeros((0, 3)), *(part.vertices_in_world() for part in self.with_role(*roles))])

    def mesh(self, *roles: Role) -> trimesh.Trimesh:
        """Return them as one mesh [m], world frame; empty where there is none."""
        return joined([trimesh.Trimesh(), *(part.mesh_in_world() for part in self.with_role(*roles))])

    def middle(self) -> Float[np.ndarray, "3"]:
        """Return where the object is, or else the hand [m], world frame: the mean of its vertices."""
        return (self.vertices("object") if self.with_role("object") else self.vertices("link", "fingertip")).mean(
            axis=0
        )

    @property
    def has_arrow(self) -> bool:
        """Whether a straight arrow shows the motion."""
        return bool(np.any(self.motion)) and self.arrow_length != 0

    def arrow(self) -> Part:
        """Return the motion as a solid arrow that starts at the object's leading edge, world frame; empty without one."""
        mesh = trimesh.Trimesh()
        if self.has_arrow:
            bodies = self.with_role("object")
            if self.arrow_from is not None:
                bodies = tuple(replace(body, T_world_part=self.arrow_from) for body in bodies)
            points = np.concatenate([body.vertices_in_world() for body in bodies])
            mesh = motion_arrow(points, self.motion, length=self.arrow_length)
        return Part("motion", "arrow", mesh, np.eye(4))


def legend(scenes: Sequence[VisualScene]) -> dict[str, Colour]:
    """Return the names of what some of these scenes show beside the hand's links, with their colours."""
    shown = {part.role for scene in scenes for part in scene.parts}
    shown |= {"arrow"} if any(scene.has_arrow for scene in scenes) else set()
    shown |= {"contact"} if any(len(scene.contacts) for scene in scenes) else set()
    return {name: tinted(role) for role, name in LEGEND.items() if role in shown}


def tinted(role: Role) -> Colour:
    """Return the colour of a role in legends: that of its parts, of the ghost paler, since it is glass."""
    tint = GHOST_TINT if role == "ghost" else 1.0
    red, green, blue = (1 - tint * (1 - channel) for channel in PALETTE[role])
    return red, green, blue


def check_same_bodies(scenes: Sequence[VisualScene]) -> None:
    """Refuse scenes of different bodies, which can be neither one page nor one recording; InputError."""
    bodies = [[(id(part.mesh), part.role) for part in scene.parts] for scene in scenes]
    for index, other in enumerate(bodies):
        if other != bodies[0]:
            raise InputError(
                f"visual scene {index} shows other bodies than scene 0; expected the same meshes in the same order; "
                "show each scene for itself"
            )


def motion_arrow(
    object_points: Float[np.ndarray, "n 3"], motion: Float[np.ndarray, "3"], *, length: float | None = None
) -> trimesh.Trimesh:
    """Return a flat solid arrow along `motion` from the leading edge of an object, at the height of its middle.

    Args:
        object_points: vertices of the object [m], world frame.
        motion: unit direction, world frame.
        length: of the arrow [m]; of a length that reads well unless given.
    """
    helper = np.array([1.0, 0.0, 0.0]) if abs(motion[2]) > UPRIGHT else np.array([0.0, 0.0, 1.0])
    across = np.cross(helper, motion)
    across /= np.linalg.norm(across)
    low, high = object_points.min(axis=0), object_points.max(axis=0)
    width = float(np.clip(LENGTH_PER_EXTENT * (high - low).max(), *LENGTH_RANGE))
    length = width if length is None else length
    middle = (low + high) / 2
    start = middle + motion * (float(((object_points - middle) @ motion).max()) + GAP)

    shaft, head, neck = SHAFT_WIDTH / 2 * width, HEAD_WIDTH / 2 * width, max(0.0, length - HEAD_LENGTH * width)
    outline = [[0, -shaft], [neck, -shaft], [neck, -head], [length, 0], [neck, head], [neck, shaft], [0, shaft]]
    flat = [[0, 1, 5], [0, 5, 6], [1, 2, 3], [1, 3, 5], [5, 3, 4]]
    arrow = trimesh.creation.extrude_triangulation(np.array(outline), np.array(flat), THICKNESS, validate=False)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([motion, across, np.cross(motion, across)])
    pose[:3, 3] = start - pose[:3, 2] * THICKNESS / 2
    return arrow.apply_transform(pose)


def turning_parts(scene: Scene, way: float) -> list[Part]:
    """Return what shows the motion of an object that turns: arc, arrow, and where it is at the end of each; else nothing.

    way: part of the motion that is shown [m].
    """
    motion, turn = scene.object_motion, scene.turn
    if turn is None:
        return []
    points = trimesh.transform_points(scene.object_mesh.vertices, scene.T_world_object)
    arm = points[int(turn.distance(points).argmax())] - turn.point
    height = (points - turn.point) @ turn.axis
    centre = turn.point + height.mean() * turn.axis
    spoke = arm - (arm @ turn.axis) * turn.axis
    spoke *= 1 + ARC_GAP / np.linalg.norm(spoke)
    angles = np.linspace(0.0, motion.angle(way), ARC_PIECES + 1)
    path = centre + Rotation.from_rotvec(angles[:, None] * turn.axis).apply(spoke)
    parts = [Part("turn", "arrow", _curved_arrow(path), np.eye(4))]
    slid = motion.slid(way)
    ends = [min(way, motion.turn_length), way] if slid else [way]
    for index, end in enumerate(ends):
        pose = motion.displacement(end) @ scene.T_world_object
        parts.append(Part(f"after {index}", "ghost", scene.object_mesh, pose))
    if slid:
        turned = trimesh.transform_points(points, motion.displacement(ends[0]))
        parts.append(Part("slide", "arrow", motion_arrow(turned, scene.motion, length=slid), np.eye(4)))
    return parts


def _curved_arrow(path: Float[np.ndarray, "n 3"]) -> trimesh.Trimesh:
    """Return a round arrow along a path [m]."""
    pieces = [trimesh.creation.cylinder(ARC_RADIUS, segment=ends, sections=12) for ends in pairwise(path)]
    ahead = path[-1] - path[-2]
    head = trimesh.creation.cone(2.5 * ARC_RADIUS, 6 * ARC_RADIUS, sections=24)
    head.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], ahead))
    return joined([*pieces, head.apply_translation(path[-1])])


def stations(scene: Scene) -> list[tuple[str, Float[np.ndarray, "4 4"]]]:
    """Return places along a scene's motion: how far the object is, in words, and its displacement."""
    motion, found = scene.object_motion, []
    for way in np.linspace(0.0, motion.length, STATIONS):
        turned = [f"{np.degrees(motion.angle(way)):.0f} deg"] if scene.turn else []
        slid = [f"{1e3 * motion.slid(way):.0f} mm"] if scene.motion_length else []
        found.append((", ".join([*turned, *slid]), motion.displacement(way)))
    return found


def surrounding_parts(mesh: trimesh.Trimesh, bounds: Float[np.ndarray, "2 3"]) -> list[Part]:
    """Return the surroundings by origin; of a large mesh what lies near the bounds, thinned."""
    origin = np.asarray(mesh.metadata.get("origin", np.zeros(len(mesh.faces), dtype=np.int8)))
    near = np.arange(len(mesh.faces))
    if len(near) > LARGE:
        near = faces_near(mesh, bounds + np.array([[-SHOWN], [SHOWN]]))
    parts = []
    for index, role in enumerate(SURROUNDINGS):
        chosen = near[origin[near] == index]
        if len(chosen) == len(mesh.faces) <= LARGE:
            parts.append(Part(role, role, mesh, np.eye(4)))
        elif len(chosen):
            part = trimesh.Trimesh(mesh.vertices, mesh.faces[chosen], process=False)
            part.remove_unreferenced_vertices()
            parts.append(Part(role, role, thinned(part), np.eye(4)))
    return parts


def visual_scenes(
    scene: Scene,
    hand: Hand,
    q: Float[np.ndarray, "batch coordinates"],
    *,
    contacts: Sequence[Float[np.ndarray, "_ 3"]] | None = None,
) -> list[VisualScene]:
    """Return what is to be seen of many configurations q (n, 9 + d) in one scene; they share their meshes.

    Raises:
        InputError: q and contacts are not of the same length.
    """
    if contacts is not None and len(contacts) != len(q):
        raise InputError(
            f"contacts of {len(contacts)} configurations were given for {len(q)}; expected one entry for each"
        )
    roles: list[Role] = [_link_role(hand, name) for name in hand.link_names]
    surroundings = [Part("environment", "environment", scene.environment_mesh, np.eye(4))]
    if "origin" in scene.environment_mesh.metadata:
        surroundings = surrounding_parts(scene.environment_mesh, scene.object_in_world().bounds)
    body = Part("object", "object", scene.object_mesh, np.asarray(scene.T_world_object))
    fixed = [body, *surroundings, *turning_parts(scene, scene.object_motion.length)]
    # What turns has arrows among its parts.
    arrow, along = (None, ()) if scene.turn is None else (0.0, tuple(stations(scene)))
    poses = hand.forward_kinematics(torch.as_tensor(np.asarray(q), dtype=torch.float64)).detach().cpu().numpy()
    result = []
    for index, T_world_links in enumerate(poses):
        links = map(Part, hand.link_names, roles, visual_meshes(hand), T_world_links)
        points = np.zeros((0, 3)) if contacts is None else np.asarray(contacts[index], dtype=np.float64).reshape(-1, 3)
        parts = tuple(part for part in (*fixed, *links) if len(part.mesh.faces))
        shown = VisualScene(
            parts, points, np.asarray(scene.motion), float(scene.motion_length), arrow_length=arrow, stations=along
        )
        result.append(shown)
    return result


def _link_role(hand: Hand, name: str) -> Role:
    if name == hand.base_link:
        return "base"
    if name in hand.coarse_links:
        return "arm"
    return "fingertip" if name in hand.fingertip_links else "link"
