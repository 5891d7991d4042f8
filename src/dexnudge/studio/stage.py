"""The 3-D part of the page: bodies that are sent once and then only moved, however many hands are shown."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation
from viser import CameraHandle, ClientHandle

from dexnudge.geometry.coarsening import thinned
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.studio.colours import sent_colour
from dexnudge.studio.server import Server
from dexnudge.viewer.camera import Camera
from dexnudge.viewer.visual_scene import CREASE_ANGLE, Colour, Part, Role, VisualScene

GROUPS: dict[str, tuple[Role, ...]] = {
    "hand": ("link", "fingertip", "arm"),
    "forearm": ("base",),
    "object": ("object",),
    "surroundings": ("environment", "assumed"),
    "unseen space": ("unseen",),
    "motion": ("arrow",),
    "goal": ("ghost",),
    "supports": ("support",),
}
"""What can be shown or hidden together, and the roles of its bodies."""
MARKS = ("contacts", "forces", "friction cones")  # further groups, of what `Layers` holds
GROUP_OF = {role: group for group, roles in GROUPS.items() for role in roles}
HANDS = ("hand", "forearm")  # groups of which each scene has its own
OPACITY = {
    "goal": 0.15,
    "unseen space": 0.20,
}  # of groups that are looked through: the arrow inside the goal stays green
ASPECT = 4 / 3  # of the window for which the first view is chosen
SAME_ANGLE = 1e-3  # [rad] of a view that need not be sent again
IDENTITY = np.array([[1.0, 0.0, 0.0, 0.0]], dtype=np.float32)
# Where many hands are shown each link keeps a quarter of its triangles, or this many: 32 hands are some 180,000.
FACES_OF_MANY, SHARE_OF_MANY = 300, 0.25


@dataclass(eq=False)
class _Body:
    """A node of the page, the mesh and the group that it is of, and what was sent of it last."""

    node: Any
    mesh: trimesh.Trimesh
    group: str
    coarse: bool
    sent: dict[str, np.ndarray] = field(default_factory=dict)


@cached_per_instance
def sent_mesh(mesh: trimesh.Trimesh, *, coarse: bool) -> trimesh.Trimesh:
    """Return a mesh as it is sent: small enough, and with its edges sharp."""
    sent = thinned(mesh)
    count = max(FACES_OF_MANY, int(SHARE_OF_MANY * len(sent.faces)))
    if coarse and len(sent.faces) > count:
        sent = sent.simplify_quadric_decimation(face_count=count)
    return trimesh.graph.smooth_shade(sent, angle=np.radians(CREASE_ANGLE))


class Stage:
    """Shows visual scenes and marks in viser's scene.

    Of many scenes, which must be of the same bodies, all hands are shown; what else there is, as in the first one.
    """

    def __init__(self, server: Server) -> None:
        self._server = server
        self._bodies: list[_Body] = []
        self._groups = {name: server.scene.add_frame(f"/{_plain(name)}", show_axes=False) for name in (*GROUPS, *MARKS)}
        self._marks: dict[str, Any] = {}
        self._opacity: dict[str, float | None] = dict(OPACITY)
        self._camera: tuple[np.ndarray, np.ndarray, float] | None = None
        server.on_client_connect(self._connected)

    def atomic(self) -> AbstractContextManager[None]:
        """Return a context whose changes appear together."""
        return self._server.atomic()

    def show(
        self,
        scenes: Sequence[VisualScene],
        *,
        extra: Sequence[Part] = (),
        colours: Sequence[Sequence[Colour]] | None = None,
    ) -> None:
        """Show scenes of the same bodies in place of what was shown; `extra` parts beside those of the first.

        colours: of each scene's parts, in place of their own.
        """
        parts, many = [*scenes[0].parts, *extra], len(scenes) > 1
        with self.atomic():
            for index in range(max(len(parts), len(self._bodies))):
                self._renew(index, parts[index] if index < len(parts) else None, many=many)
            self._bodies = self._bodies[: len(parts)]
            for index, part in enumerate(parts):
                mine = [scene.parts[index] for scene in scenes] if GROUP_OF[part.role] in HANDS else [part]
                own = [each.colour for each in mine]
                if colours is not None and index < len(scenes[0].parts):
                    own = [each[index] for each in colours[: len(mine)]]
                self._place(
                    self._bodies[index], np.stack([each.T_world_part for each in mine]), sent_colour(np.array(own))
                )

    def _renew(self, index: int, part: Part | None, *, many: bool) -> None:
        """Make the node at a place that of a part, unless it is already; None takes it away."""
        old = self._bodies[index] if index < len(self._bodies) else None
        group = GROUP_OF[part.role] if part else ""
        coarse = many and group in HANDS
        if old and part and old.mesh is part.mesh and (old.group, old.coarse) == (group, coarse):
            return
        if old:
            old.node.remove()
        if part is None:
            return
        sent = sent_mesh(part.mesh, coarse=coarse)
        node = self._server.scene.add_batched_meshes_simple(
            f"/{_plain(group)}/{index}_{_plain(part.name)}",
            vertices=sent.vertices,
            faces=sent.faces,
            batched_wxyzs=np.array([[1.0, 0.0, 0.0, 0.0]]),
            batched_positions=np.zeros((1, 3)),
            batched_colors=sent_colour(np.array([part.colour])),
            opacity=self._opacity.get(group),
            lod="off",
            side="front" if part.mesh.is_watertight else "double",  # what is transparent and double is drawn twice
            cast_shadow=False,
            receive_shadow=False,
        )
        self._bodies[index : index + 1] = [_Body(node, part.mesh, group, coarse)]

    def _place(self, body: _Body, T: Float[np.ndarray, "n 4 4"], colours: UInt8[np.ndarray, "n 3"]) -> None:
        """Move one body: the first as a node, which costs the browser least, the others relative to it."""
        relative = np.linalg.inv(T[0]) @ T
        values = {
            "position": T[0, :3, 3],
            "wxyz": _quaternions(T[:1])[0],
            "batched_positions": relative[:, :3, 3].astype(np.float32),
            "batched_wxyzs": _quaternions(relative).astype(np.float32),
            "batched_colors": colours,
        }
        if len(T) == 1:
            values |= {"batched_positions": np.zeros((1, 3), np.float32), "batched_wxyzs": IDENTITY}
        for name, value in values.items():
            if name not in body.sent or not np.array_equal(body.sent[name], value):
                setattr(body.node, name, value)
                body.sent[name] = value

    def move_object(self, T_world_object: Float[np.ndarray, "4 4"]) -> None:
        """Move the object alone, as while it is dragged."""
        for body in self._bodies:
            if body.group == "object":
                self._place(body, T_world_object[None], body.sent["batched_colors"])

    def fade(self, group: str, opacity: float) -> None:
        """Look through a group's bodies: at 0 nothing of them is seen, at 1 nothing of what is behind."""
        self._opacity[group] = opacity if opacity < 1.0 else None
        for body in self._bodies:
            if body.group == group:
                body.node.opacity = self._opacity[group]

    def hide(self, group: str, *, hidden: bool) -> None:
        """Hide or show one of `GROUPS` and `MARKS`."""
        self._groups[group].visible = not hidden

    def arrows(self, group: str, name: str, arrows: Float[np.ndarray, "n 2 3"], colour: Colour) -> None:
        """Show arrows (tail, head) [m] in a group, in place of those of this name."""
        self.unmark(name)
        if len(arrows):
            self._marks[name] = self._server.scene.add_arrows(
                f"/{_plain(group)}/{_plain(name)}",
                arrows,
                sent_colour(np.array(colour)),
                shaft_radius=0.0012,
                head_radius=0.003,
                head_length=0.006,
            )

    def dots(self, group: str, name: str, points: Float[np.ndarray, "n 3"], radius: float, colour: Colour) -> None:
        """Show balls [m] in a group, in place of those of this name."""
        self.unmark(name)
        if len(points):
            ball = trimesh.creation.icosphere(subdivisions=1, radius=radius)
            self._marks[name] = self._server.scene.add_batched_meshes_simple(
                f"/{_plain(group)}/{_plain(name)}",
                vertices=ball.vertices,
                faces=ball.faces,
                batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (len(points), 1)),
                batched_positions=points,
                batched_colors=sent_colour(np.array(colour)),
                lod="off",
                cast_shadow=False,
                receive_shadow=False,
            )

    def glass(self, group: str, name: str, mesh: trimesh.Trimesh, colour: Colour, opacity: float) -> None:
        """Show a mesh [m, world] that is looked through in a group, in place of that of this name."""
        self.unmark(name)
        if len(mesh.faces):
            self._marks[name] = self._server.scene.add_mesh_simple(
                f"/{_plain(group)}/{_plain(name)}",
                mesh.vertices,
                mesh.faces,
                color=colour,  # of a single mesh: sRGB
                opacity=opacity,
                flat_shading=True,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )

    def unmark(self, *names: str) -> None:
        """Remove marks, all of them unless some are named."""
        for name in names or tuple(self._marks):
            if (mark := self._marks.pop(name, None)) is not None:
                mark.remove()

    def look(self, camera: Camera, target: Float[np.ndarray, "3"]) -> None:
        """Look from a camera for `ASPECT`, turning about the point of its view that is as far away as `target` [m]."""
        distance = float((target - camera.position) @ camera.forward)
        self._camera = (
            camera.position,
            camera.position + distance * camera.forward,
            2 * float(np.arctan(camera.tan_height)),
        )
        first = self._server.initial_camera
        first.position, first.look_at, first.fov = self._camera
        for client in self._server.get_clients().values():
            self._aim(client)

    def _connected(self, client: ClientHandle) -> None:
        self._aim(client)
        client.camera.on_update(self._fit)  # the window narrows as its panel opens

    def _fit(self, camera: CameraHandle) -> None:
        if self._camera is not None:
            angle = fitted(self._camera[2], camera.image_width, camera.image_height)
            if abs(camera.fov - angle) > SAME_ANGLE:
                camera.fov = angle

    def _aim(self, client: ClientHandle) -> None:
        """Set a browser's camera; one that has just connected does not always heed the initial one."""
        if self._camera is not None:
            position, target, angle = self._camera
            with client.atomic():
                client.camera.position, client.camera.look_at = position, target
                client.camera.fov = fitted(angle, client.camera.image_width, client.camera.image_height)


def fitted(angle: float, width: int, height: int) -> float:
    """Return the vertical angle of view [rad] by which a window shows the width that `angle` shows in one of `ASPECT`.

    width, height: of the window [pixels]; the angle stays where it is no narrower.
    """
    return 2 * float(np.arctan(np.tan(angle / 2) * max(1.0, ASPECT * height / max(width, 1))))


def _plain(name: str) -> str:
    return re.sub(r"\W+", "_", name)


def _quaternions(T: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4"]:
    return Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True)
