"""Whether the object stands where something can carry it: neither inside its surroundings nor away from them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.overlap import deepest_overlap, way_to_surface
from dexnudge.geometry.surface_lattice import surface_lattice
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.finding import Finding, direction_text, length_text, vector_text

INITIAL_PENETRATION_LIMIT = 1e-3  # [m] the limit that a configuration must keep, applied to the scene itself
SCATTER = 3.0  # standard deviations of a measured surface by which it may reach into the object as well
SUPPORT_LIMIT = 1e-3  # [m] farther from the surroundings than this nothing carries the object
POSE_UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254}  # [m] that a position may be in by mistake
ROUGHLY = 5e-3  # [m] a mistake explains what is worse than this; what remains then is noise, or mended by settling
PLAIN_MISTAKE = 5e-2  # [m] the same for a unit, which brings any object nearer to the origin, and often to the ground
QUICK_SPACING = 0.006  # [m] between the object's points by which a mistaken pose is ruled out
QUARTER_TURN = np.pi / 2


@cached_per_instance
def surroundings_distance(environment_mesh: trimesh.Trimesh) -> ExactDistance:
    """Return the exact distance to surroundings; the tree is built once per mesh."""
    return ExactDistance(environment_mesh.copy(include_cache=True))  # it keeps its mesh, and would keep the key alive


def placement_findings(
    object_mesh: trimesh.Trimesh,
    environment_mesh: trimesh.Trimesh,
    T_world_object: Float[np.ndarray, "4 4"],
    *,
    noise: float = 0.0,
) -> tuple[Finding, ...]:
    """Return an error where the surroundings penetrate the object by more than 1 mm, or do not come within 1 mm of it.

    Surfaces that scatter by `noise` [m] may penetrate it by three times as much more.

    Both ways: points of the object inside the environment and points of the environment inside the object. Where the
    object would touch after a mistake that is often made with poses and scans, the remedy names that mistake.
    """
    surroundings = surroundings_distance(environment_mesh)
    body = _placed(object_mesh, T_world_object)
    depth, point, way = deepest_overlap(body, surroundings)
    allowed = INITIAL_PENETRATION_LIMIT + SCATTER * noise
    if depth > allowed:
        sentence = (
            f"the environment already penetrates the object by {1e3 * depth:.1f} mm near {vector_text(point, digits=3)} m "
            f"in the world; expected at most {1e3 * allowed:.2g} mm"
        )
        move = f"move the object away from that surface by {vector_text(way)} m in the world"
        mistakes = _mistakes(object_mesh, surroundings, T_world_object, depth)
        return (Finding("error", "pose", sentence, next(mistakes, move)),)
    way = way_to_surface(body, surroundings, enough=SUPPORT_LIMIT)
    distance = float(np.linalg.norm(way))
    if distance > SUPPORT_LIMIT:
        sentence = (
            f"the object touches nothing: the nearest surface is {length_text(distance)} {direction_text(way)}; expected "
            f"at most {1e3 * SUPPORT_LIMIT:.0f} mm"
        )
        move = f"move the object by {vector_text(way)} m in the world"
        mistakes = _mistakes(object_mesh, surroundings, T_world_object, distance)
        return (Finding("error", "pose", sentence, next(mistakes, move)),)
    return ()


def _placed(mesh: trimesh.Trimesh, pose: Float[np.ndarray, "4 4"]) -> trimesh.Trimesh:
    placed = mesh.copy()
    placed.apply_transform(pose)
    return placed


def _mistakes(
    object_mesh: trimesh.Trimesh, surroundings: ExactDistance, T_world_object: Float[np.ndarray, "4 4"], wrong_by: float
) -> Iterator[str]:
    """Yield the mistakes in pose or scan without which the object would touch its surroundings and not enter them.

    wrong_by: depth or distance [m] that a mistake must explain.
    """
    points = surface_lattice(np.asarray(object_mesh.triangles), spacing=QUICK_SPACING)[0]
    found: list[tuple[float, str, Float[np.ndarray, "4 4"], float]] = []
    for question, pose, plain in _other_poses(T_world_object):
        limit = ROUGHLY if wrong_by > (PLAIN_MISTAKE if plain else ROUGHLY) else SUPPORT_LIMIT
        gap = abs(float(surroundings(trimesh.transform_points(points, pose)).distance.min()))
        if gap <= limit:
            found.append((gap, question, pose, limit))
    for _, question, pose, limit in sorted(found, key=lambda entry: entry[0]):  # the best explanation first
        if deepest_overlap(_placed(object_mesh, pose), surroundings)[0] <= limit:
            yield f"{question}: it would touch there"


def _other_poses(pose: Float[np.ndarray, "4 4"]) -> Iterator[tuple[str, Float[np.ndarray, "4 4"], bool]]:
    """Yield poses that may have been meant, and whether only the position changes; turned surroundings as another pose."""
    for unit, metres in POSE_UNITS.items():
        scaled = pose.copy()
        scaled[:3, 3] *= metres
        yield f"is the pose in {unit}? give its position in metres", scaled, True
    transposed = pose.copy()
    transposed[:3, :3] = pose[:3, :3].T
    if not np.allclose(transposed, pose):
        yield (
            "is the rotation of the pose transposed? give T_world_object, which maps object to world",
            transposed,
            False,
        )
        inverse = np.linalg.inv(pose)
        yield "is the pose inverted? give T_world_object, which maps object to world", inverse, False
    upside_down = trimesh.transformations.rotation_matrix(-2 * QUARTER_TURN, [1, 0, 0])
    yield "is the scan upside down? z points up: turn the environment by 180 degrees about x", upside_down @ pose, False
    y_up = trimesh.transformations.rotation_matrix(-QUARTER_TURN, [1, 0, 0])
    yield "is the scan y-up? z points up: turn the environment by 90 degrees about x", y_up @ pose, False
