"""A scene before anything is sampled, as picture and page: what carries the object, and how far its way is free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, UInt8

from dexnudge.finding import Finding
from dexnudge.scenes.free_way import FreeWay
from dexnudge.scenes.scene import Scene
from dexnudge.viewer.camera import Camera, choose_camera, framing_camera
from dexnudge.viewer.page import write_template
from dexnudge.viewer.page_data import ASPECT, page_data
from dexnudge.viewer.picture import SIZE, render_array
from dexnudge.viewer.visual_scene import (
    PALETTE,
    SURROUNDINGS,
    Part,
    Role,
    VisualScene,
    stations,
    surrounding_parts,
    turning_parts,
)

AROUND = 0.10  # [m] of the surroundings that the picture shows beside object and motion
RING_WIDTH = 0.005  # [m] of the outline of what carries the object
SHARPEST = 0.2  # of a corner's mitre: sharper ones are blunted
RING_RAISED = 0.0004  # [m] above the support, so that both are told apart
OBSTACLE_RADIUS = 0.006  # [m] of the ball that marks where the way ends
SHORTEST_ARROW = 0.004  # [m]
SCENE_LEGEND: dict[Role, str] = {"object": "object", "support": "carries it", "arrow": "free way"}
WHERE_THERE: dict[Role, str] = {
    "obstacle": "obstacle",
    "ghost": "after it",
    "environment": "surroundings",
    "assumed": "assumed",
    "unseen": "not seen",
}


def scene_view(scene: Scene, way: FreeWay | None = None) -> VisualScene:
    """Return what is to be seen of a scene: surroundings by origin, outlines of the supports, the free way, its obstacle.

    way: the part of the motion that is free; None where it is not known, as for a misplaced object.
    """
    body = scene.object_in_world()
    parts = [Part("object", "object", scene.object_mesh, np.asarray(scene.T_world_object))]
    parts += surrounding_parts(scene.environment_mesh, body.bounds)
    for index, support in enumerate(scene.supports):
        ring = _ring(np.asarray(support.corners), np.asarray(support.normal))
        parts.append(Part(f"support {index}", "support", ring, np.eye(4)))
    parts += turning_parts(scene, way.length) if way is not None else []
    if way is not None and way.place is not None and not way.whole:
        ball = trimesh.creation.icosphere(subdivisions=3, radius=OBSTACLE_RADIUS)
        parts.append(Part("obstacle", "obstacle", ball, trimesh.transformations.translation_matrix(way.place)))
    kept = tuple(part for part in parts if len(part.mesh.faces))
    motion = np.zeros(3) if way is None else np.asarray(scene.motion)
    arrow = 0.0 if way is None or scene.turn is not None else max(way.length, SHORTEST_ARROW)
    return VisualScene(kept, np.zeros((0, 3)), motion, scene.motion_length, arrow_length=arrow)


def along_motion(scene: Scene, view: VisualScene) -> list[tuple[str, VisualScene]]:
    """Return what is to be seen while the object makes its motion, and how far it is: from where it lies to the end."""
    found, body = [], next(part for part in view.parts if part.role == "object")
    for label, T in stations(scene):
        pose = T @ scene.T_world_object
        parts = tuple(replace(part, T_world_part=pose) if part is body else part for part in view.parts)
        found.append((label, replace(view, parts=parts)))
    return found


def scene_picture(view: VisualScene, *, size: tuple[int, int] = SIZE) -> UInt8[np.ndarray, "height width 3"]:
    """Return the picture of what `scene_view` returns as sRGB bytes; unseen surroundings are looked through."""
    return render_array(view, size=size, camera=_camera(view, size[0] / size[1]))


def write_scene_page(
    views: Sequence[tuple[str, VisualScene]], path: Path | str, *, title: str, findings: Sequence[Finding]
) -> Path:
    """Write the page: a 3-D view, and the findings.

    Args:
        views: as `along_motion` returns them.
        path: of the HTML file.
        title: plain text; whatever stands in it is shown, never interpreted.
        findings: listed beside the view.

    Raises:
        OutputError: the file cannot be written.
    """
    view = views[0][1]
    names = SCENE_LEGEND | {role: name for role, name in WHERE_THERE.items() if view.with_role(role)}
    legend = {name: PALETTE[role] for role, name in names.items()}
    rows = "\n".join(_row(finding) for finding in findings)
    data = page_data([each for _, each in views], camera=_camera(view, ASPECT))
    data["labels"] = [label for label, _ in views]
    return write_template(path, "scene", data, legend, title=escape(title), rows=rows)


def _row(finding: Finding) -> str:
    remedy = f'<div class="remedy">{escape(finding.remedy)}</div>' if finding.remedy else ""
    kind = {"error": "no", "warning": "odd", "note": "soft"}[finding.level]
    return (
        f'<tr><td class="text {kind}">{finding.level}</td><td class="text">{escape(finding.what)}</td>'
        f'<td class="sentence">{escape(finding.sentence)}{remedy}</td></tr>'
    )


def _camera(view: VisualScene, aspect: float) -> Camera:
    """Return the best view of object and motion, from so far away that what is around them is seen too."""
    best = choose_camera(view, aspect=aspect)
    seen, around = view.vertices("object", "obstacle", "ghost", "arrow"), view.vertices(*SURROUNDINGS)
    seen = np.concatenate([seen, seen + view.motion * view.motion_length])
    if not view.motion.any():  # a misplaced object: where are they?
        seen = np.concatenate([seen, around])
    low = np.maximum(seen.min(axis=0) - AROUND, around.min(axis=0)).clip(max=seen.min(axis=0))
    high = np.minimum(seen.max(axis=0) + AROUND, around.max(axis=0)).clip(min=seen.max(axis=0))
    corners = trimesh.bounds.corners(np.array([low, high]))
    return framing_camera(corners, azimuth=best.azimuth, elevation=best.elevation, aspect=aspect)


def _ring(corners: Float[np.ndarray, "corner 3"], normal: Float[np.ndarray, "3"]) -> trimesh.Trimesh:
    """Return a flat ribbon around the outline of a convex patch; empty for a line or a point."""
    if len(corners) < 3:
        return trimesh.Trimesh()
    ahead = np.roll(corners, -1, axis=0) - corners
    outward = np.cross(ahead, normal)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    outward *= np.sign(((corners - corners.mean(axis=0)) * outward).sum())
    mitre = outward + np.roll(outward, 1, axis=0)
    mitre /= np.maximum((mitre * outward).sum(axis=1, keepdims=True), SHARPEST)
    rim = np.concatenate([corners, corners + RING_WIDTH * mitre]) + RING_RAISED * normal
    count = len(corners)
    here, after = np.arange(count), np.roll(np.arange(count), -1)
    faces = np.concatenate(
        [np.column_stack([here, here + count, after + count]), np.column_stack([here, after + count, after])]
    )
    return trimesh.Trimesh(rim, faces, process=False)
