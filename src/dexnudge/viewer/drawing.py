"""What is to be seen of one configuration: parts with their poses, contact points, the motion.

Pictures and pages both take a `Drawing`, so neither knows hands or scenes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from jaxtyping import Float

from dexnudge.errors import InputError
from dexnudge.hands.hand import Hand
from dexnudge.scenes.scene import Scene
from dexnudge.viewer.arrow import motion_arrow
from dexnudge.viewer.palette import Role


@dataclass(frozen=True, eq=False)
class Part:
    """One rigid body: `mesh` [m] in its own frame, `T_world_part` (4, 4), and what it is."""

    name: str
    role: Role
    mesh: trimesh.Trimesh
    T_world_part: Float[np.ndarray, "4 4"]

    def vertices_in_world(self) -> Float[np.ndarray, "n 3"]:
        """Vertices [m], world frame."""
        return trimesh.transform_points(self.mesh.vertices, self.T_world_part)

    def mesh_in_world(self) -> trimesh.Trimesh:
        """The mesh [m], world frame; as many vertices and triangles in the same order."""
        return trimesh.Trimesh(self.vertices_in_world(), self.mesh.faces, process=False)


@dataclass(frozen=True, eq=False)
class Drawing:
    """One configuration in its scene.

    Attributes:
        parts: object, environment and links; parts without triangles are left out.
        contacts: points where hand and object touch [m], world frame.
        motion: unit direction in which the object shall move, world frame; zero where it shall not, as in a grasp.
        motion_length: how far [m].
        title: plain text, drawn as given; it may come from a file name.
    """

    parts: tuple[Part, ...]
    contacts: Float[np.ndarray, "n 3"]
    motion: Float[np.ndarray, "3"]
    motion_length: float = 0.10
    title: str = ""

    def __post_init__(self) -> None:
        if not any(part.role == "object" for part in self.parts):
            raise InputError("a drawing needs a part with the role 'object'; expected one or more, got none")

    def with_role(self, *roles: Role) -> tuple[Part, ...]:
        """The parts that have one of these roles."""
        return tuple(part for part in self.parts if part.role in roles)

    def arrow(self) -> Part:
        """The motion as a solid arrow that starts at the object's leading edge, in the world frame; empty without one."""
        if not np.any(self.motion):
            return Part("motion", "arrow", trimesh.Trimesh(), np.eye(4))
        points = np.concatenate([part.vertices_in_world() for part in self.with_role("object")])
        return Part("motion", "arrow", motion_arrow(points, self.motion), np.eye(4))


def drawing(
    scene: Scene,
    hand: Hand,
    q: Float[np.ndarray, " coordinates"],
    *,
    contacts: Float[np.ndarray, "n 3"] | None = None,
    title: str = "",
) -> Drawing:
    """The drawing of one configuration q (9 + d,); `contacts` are world points [m]."""
    return drawings(scene, hand, np.asarray(q)[None], contacts=None if contacts is None else [contacts], title=title)[0]


def drawings(
    scene: Scene,
    hand: Hand,
    q: Float[np.ndarray, "batch coordinates"],
    *,
    contacts: Sequence[Float[np.ndarray, "_ 3"]] | None = None,
    title: str = "",
) -> list[Drawing]:
    """The drawings of many configurations q (n, 9 + d) in one scene; they share their meshes.

    Raises:
        InputError: q and contacts are not of the same length.
    """
    if contacts is not None and len(contacts) != len(q):
        raise InputError(
            f"contacts of {len(contacts)} configurations were given for {len(q)}; expected one entry for each"
        )
    fixed = [
        Part("object", "object", scene.object_mesh, np.asarray(scene.T_world_object)),
        Part("environment", "environment", scene.environment_mesh, np.eye(4)),
    ]
    poses = hand.forward_kinematics(torch.as_tensor(np.asarray(q), dtype=torch.float64)).detach().cpu().numpy()
    result = []
    for index, T_world_links in enumerate(poses):
        links = [
            Part(name, _link_role(hand, name), mesh, pose)
            for name, mesh, pose in zip(hand.link_names, hand.link_meshes, T_world_links, strict=True)
        ]
        points = np.zeros((0, 3)) if contacts is None else np.asarray(contacts[index], dtype=np.float64).reshape(-1, 3)
        parts = tuple(part for part in (*fixed, *links) if len(part.mesh.faces))
        result.append(Drawing(parts, points, np.asarray(scene.motion), float(scene.motion_length), title))
    return result


def _link_role(hand: Hand, name: str) -> Role:
    if name == hand.base_link:
        return "base"
    return "fingertip" if name in hand.fingertip_links else "link"
