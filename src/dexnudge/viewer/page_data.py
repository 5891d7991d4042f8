"""What a 3-D page draws: each mesh once, its pose in every configuration, colours, and from where to look first."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh

from dexnudge.errors import InputError
from dexnudge.viewer.camera import TAN_HALF_HEIGHT, Camera
from dexnudge.viewer.drawing import Drawing
from dexnudge.viewer.page_geometry import encoded, page_geometry
from dexnudge.viewer.palette import PALETTE, Role
from dexnudge.viewer.viewpoint import choose_camera

ASPECT = 4 / 3  # of the stage for which the first view is chosen
BALL_RADIUS = 0.0035  # [m] of a contact
EDGE = (0.42, 0.42, 0.44)  # sRGB of the surroundings' edges
MOVING: tuple[Role, ...] = ("object", "link", "fingertip", "base")


def check_same_bodies(drawings: Sequence[Drawing]) -> None:
    """Refuse drawings of different bodies, which one page cannot show; InputError."""
    bodies = [[(id(part.mesh), part.role) for part in drawing.parts] for drawing in drawings]
    for index, other in enumerate(bodies):
        if other != bodies[0]:
            raise InputError(
                f"drawing {index} shows other bodies than drawing 0; expected the same meshes in the same order; "
                "write one page for each scene"
            )


def page_data(drawings: Sequence[Drawing], *, camera: Camera | None = None) -> dict[str, Any]:
    """What `stage.js` draws of one or more drawings of the same bodies.

    `configurations` holds the poses (3 x 4 float32 of each body, world) and contacts [m] of each; `arrow` and `ball` are
    the geometries of the motion's arrow, as the first drawing has it, and of a contact. camera: where to look from at
    first, the best view of the first drawing unless given.
    """
    first = drawings[0]
    meshes: dict[int, trimesh.Trimesh] = {id(part.mesh): part.mesh for part in first.parts}
    place = {key: index for index, key in enumerate(meshes)}
    extra = [first.arrow().mesh, trimesh.creation.icosphere(subdivisions=2, radius=BALL_RADIUS)]
    return {
        "geometries": [page_geometry(mesh) for mesh in [*meshes.values(), *extra]],
        "arrow": len(meshes),
        "ball": len(meshes) + 1,
        "bodies": [
            {"geometry": place[id(part.mesh)], "role": part.role, "moves": part.role in MOVING} for part in first.parts
        ],
        "configurations": [
            {
                "poses": encoded(np.stack([part.T_world_part[:3] for part in drawing.parts]).astype(np.float32)),
                "contacts": np.round(drawing.contacts, 5).tolist(),
            }
            for drawing in drawings
        ],
        "palette": {**PALETTE, "edge": EDGE},
        "motion": first.motion.tolist(),
        "motion_length": first.motion_length,
        "camera": _camera(first, camera or choose_camera(first, aspect=ASPECT)),
    }


def _camera(drawing: Drawing, camera: Camera) -> dict[str, Any]:
    """The camera as the page turns it: about a point near the object."""
    middle = np.concatenate([part.vertices_in_world() for part in drawing.with_role("object")]).mean(axis=0)
    distance = float((middle - camera.position) @ camera.forward)
    return {
        "target": (camera.position + distance * camera.forward).tolist(),
        "distance": distance,
        "azimuth": float(np.arctan2(-camera.forward[1], -camera.forward[0])),
        "elevation": float(np.arcsin(-camera.forward[2])),
        "tangent": TAN_HALF_HEIGHT,
    }
