"""What a page's script draws: meshes, poses and colours, as data that travel in the page."""

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh

from dexnudge.geometry.coarsening import thinned
from dexnudge.viewer.camera import Camera, choose_camera
from dexnudge.viewer.picture import corner_normals
from dexnudge.viewer.visual_scene import (
    CONTACT_RADIUS,
    CREASE_ANGLE,
    PALETTE,
    ROBOT,
    SURROUNDINGS,
    Role,
    VisualScene,
    check_same_bodies,
)

ASPECT = 4 / 3  # of the stage for which the first view is chosen
EDGE = (0.42, 0.42, 0.44)  # sRGB of the surroundings' edges
MOVING: tuple[Role, ...] = ("object", "link", "fingertip", "base", "arm")
NORMAL_SCALE = 127  # normals travel as signed bytes
SHORT_INDEX = 65_536  # vertices that an index of two bytes can count


def page_data(scenes: Sequence[VisualScene], *, camera: Camera | None = None) -> dict[str, Any]:
    """Return what `stage.js` draws of one or more visual scenes of the same bodies.

    `configurations` holds the poses (3 x 4 float32 of each body, world) and contacts [m] of each; `arrow` and `ball` are
    the geometries of the motion's arrow, as the first scene has it, and of a contact. Base and arm beside an object may be
    `glass`: where they hide object or hand, from where one looks, in one configuration or another.

    Args:
        scenes: the same meshes in the same order.
        camera: where to look from at first; the best view of the first scene unless given.

    Raises:
        InputError: scenes of different bodies, which one page cannot show.
    """
    check_same_bodies(scenes)
    first = scenes[0]
    meshes: dict[int, trimesh.Trimesh] = {id(part.mesh): part.mesh for part in first.parts}
    place = {key: index for index, key in enumerate(meshes)}
    arrow, ball = first.arrow().mesh, trimesh.creation.icosphere(subdivisions=2, radius=CONTACT_RADIUS)
    extra = [arrow if len(arrow.faces) else ball, ball]  # where nothing moves no arrow is drawn
    return {
        "geometries": [page_geometry(mesh) for mesh in [*meshes.values(), *extra]],
        "arrow": len(meshes),
        "ball": len(meshes) + 1,
        "bodies": [
            {
                "geometry": place[id(part.mesh)],
                "role": part.role,
                "colour": part.colour,
                "moves": part.role in MOVING,
                "surrounds": part.role in (*SURROUNDINGS, "ghost"),
                "glass": part.role in ROBOT and bool(first.with_role("object")),
            }
            for part in first.parts
        ],
        "configurations": [
            {
                "poses": encoded(np.stack([part.T_world_part[:3] for part in scene.parts]).astype(np.float32)),
                "contacts": np.round(scene.contacts, 5).tolist(),
            }
            for scene in scenes
        ],
        "palette": {**PALETTE, "edge": EDGE},
        "motion": first.motion.tolist(),
        "motion_length": first.motion_length,
        "has_arrow": first.has_arrow,
        "stations": [[label, np.round(T[:3], 6).ravel().tolist()] for label, T in first.stations],
        "camera": _camera(first, camera or choose_camera(first, aspect=ASPECT)),
    }


def _camera(scene: VisualScene, camera: Camera) -> dict[str, Any]:
    """Return the camera as the page turns it: about a point near the object, or near a hand that is alone."""
    distance = float((scene.middle() - camera.position) @ camera.forward)
    return {
        "target": (camera.position + distance * camera.forward).tolist(),
        "distance": distance,
        "azimuth": camera.azimuth,
        "elevation": camera.elevation,
        "tangent": camera.tan_height,
    }


def page_geometry(mesh: trimesh.Trimesh) -> dict[str, Any]:
    """Return `positions` float32 [m], `normals` int8 (x, y, z, 0), `indices`, `edges` float32 pairs of ends, `closed`."""
    mesh = thinned(mesh)
    normals = np.rint(corner_normals(mesh).reshape(-1, 3) * NORMAL_SCALE).astype(np.int64)
    # A corner is its vertex and its normal; as one number each, which sorts faster than rows.
    corners = np.asarray(mesh.faces, dtype=np.int64).reshape(-1)
    for axis in range(3):
        corners = corners * 256 + normals[:, axis] + 128
    _, first, indices = np.unique(corners, return_index=True, return_inverse=True)
    index_type = np.dtype(np.uint16 if len(first) <= SHORT_INDEX else np.uint32)
    sharp = mesh.face_adjacency_angles > np.radians(CREASE_ANGLE)
    return {
        "positions": encoded(np.asarray(mesh.vertices)[mesh.faces.reshape(-1)[first]].astype(np.float32)),
        "normals": encoded(np.column_stack([normals[first], np.zeros(len(first))]).astype(np.int8)),
        "indices": encoded(indices.reshape(-1).astype(index_type)),
        "index_bytes": index_type.itemsize,
        "edges": encoded(np.asarray(mesh.vertices)[mesh.face_adjacency_edges[sharp]].astype(np.float32)),
        "closed": bool(mesh.is_watertight),
    }


def encoded(array: np.ndarray) -> str:
    """Return the Base64 of an array's bytes, little-endian."""
    return base64.b64encode(array.astype(array.dtype.newbyteorder("<")).tobytes()).decode("ascii")
