"""Whether the object stands where something can carry it, and the sizes of a scene as understood: is it another unit?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from dexnudge.finding import Finding, Level, direction_text, length_text, vector_text
from dexnudge.geometry.exact_distance import ExactDistance, ExactHit, Rays
from dexnudge.geometry.meshes import LONGEST_ENVIRONMENT, LONGEST_OBJECT, SHORTEST_OBJECT
from dexnudge.geometry.meshes import UNITS as METRES_PER_UNIT
from dexnudge.geometry.overlap import deepest_overlap, way_to_surface
from dexnudge.geometry.surface_lattice import faces_near, surface_lattice
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.supports import facing_points

INITIAL_PENETRATION_LIMIT = 1e-3  # [m] the limit that a configuration must keep, applied to the scene itself
SCATTER = 3.0  # standard deviations of a measured surface by which it may reach into the object as well
SUPPORT_LIMIT = 1e-3  # [m] farther from the surroundings than this nothing carries the object
POSE_UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254}  # [m] that a position may be in by mistake
ROUGHLY = 5e-3  # [m] from touching that an object may be after a mistake: spikes of a scan, or mended by settling
BETTER = 2.0  # times nearer to touching than as given, or a mistake explains little
PLAIN_MISTAKE = 1.0  # [m] a unit explains what is worse: it brings any object nearer to the origin, often to the ground
FAR = 0.02  # [m] by which a mistake moves the object at least: what is less is an error of its pose
BALANCED = 2e-3  # [m] its centre may be outside of what would then carry it
COINCIDES = 2e-3  # [m] from the object's upper side that a scan of it is
ASIDE = 0.01  # [m] beside the object, where its own surface does not go on
MOST_SCANNED = 0.5  # of its upper side along which the surroundings may have a surface that faces the same way
QUICK_SPACING = 0.006  # [m] between the object's points by which a mistaken pose is ruled out
CARRIES = 0.5  # least vertical component of the normal of what carries an object


@cached_per_instance
def surroundings_distance(environment_mesh: trimesh.Trimesh, *, device: str = "cpu") -> ExactDistance:
    """Return the exact distance to surroundings; the tree is built once per mesh."""
    # It keeps its mesh, and would keep the key alive.
    return ExactDistance(environment_mesh.copy(include_cache=True), device=device)


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
    body = object_mesh.copy().apply_transform(T_world_object)
    if (share := _scanned_too(body, surroundings)) > MOST_SCANNED:
        if (thickness := float(body.extents[2])) <= COINCIDES:
            sentence = (
                f"the object is {1e3 * thickness:.2g} mm high as it lies; expected more than {1e3 * COINCIDES:g} mm"
            )
            remedy = "what is thinner cannot be told from what carries it; thicken its mesh, or mend its `units`"
            return (Finding("error", "pose", sentence, remedy),)
        sentence = (
            f"{share:.0%} of the object's upper side coincides with a surface of the surroundings; expected none there"
        )
        return (Finding("error", "pose", sentence, "was the object scanned too? cut it out of the `environment`"),)
    depth, point, way = deepest_overlap(body, surroundings)
    allowed = INITIAL_PENETRATION_LIMIT + SCATTER * noise
    if depth > allowed:
        sunk, place = _sunk(body, environment_mesh)
        if sunk > depth:
            depth, point, way = sunk, place, np.array([0.0, 0.0, sunk])
        sentence = (
            f"the environment already penetrates the object by {1e3 * depth:.1f} mm near {vector_text(point, digits=3)} m "
            f"in the world; expected at most {1e3 * allowed:.2g} mm"
        )
        move = f"move the object away from that surface by {vector_text(way)} m in the world"
        return (Finding("error", "pose", sentence, _remedy(object_mesh, surroundings, T_world_object, depth, move)),)
    way = way_to_surface(body, surroundings, enough=SUPPORT_LIMIT)
    distance = float(np.linalg.norm(way))
    if distance > SUPPORT_LIMIT:
        sentence = (
            f"the object touches nothing: the nearest surface is {length_text(distance)} {direction_text(way)}; expected "
            f"at most {1e3 * SUPPORT_LIMIT:.0f} mm"
        )
        move = f"move the object by {vector_text(way)} m in the world"
        return (Finding("error", "pose", sentence, _remedy(object_mesh, surroundings, T_world_object, distance, move)),)
    return ()


def _scanned_too(body: trimesh.Trimesh, surroundings: ExactDistance) -> float:
    """Return the share of a body's upper side along which the surroundings have a surface that faces the same way."""
    points = facing_points(body, np.array([0.0, 0.0, 1.0]))
    if len(points) < 3 or np.ptp(points[:, :2], axis=0).min() < COINCIDES:
        return 0.0
    outline = points[ConvexHull(points[:, :2]).vertices]
    outward = (outline - outline.mean(axis=0)) * [1.0, 1.0, 0.0]
    beyond = outline + ASIDE * outward / np.linalg.norm(outward, axis=1, keepdims=True)
    beyond[:, 2] = points[:, 2].max()
    if np.median(surroundings.to_surface(beyond).distance) < min(ASIDE / 2, float(body.extents[2]) / 2):
        return 0.0  # the surface goes on: the object is sunk into what carries it
    hit = surroundings.to_surface(points, reach=COINCIDES)
    return float(((hit.distance <= COINCIDES) & (hit.normal[:, 2] > CARRIES)).mean())


def _sunk(body: trimesh.Trimesh, environment_mesh: trimesh.Trimesh) -> tuple[float, Float[np.ndarray, "3"]]:
    """Return how far an open sheet that could carry a body is above its lowest side [m], and where; 0 without.

    A sheet has no bounds in which to look for points that are behind it.
    """
    near = np.zeros(0, dtype=np.int64) if environment_mesh.is_watertight else faces_near(environment_mesh, body.bounds)
    if len(near) == 0:
        return 0.0, np.zeros(3)
    points = facing_points(body, np.array([0.0, 0.0, -1.0]))
    sheet = trimesh.Trimesh(environment_mesh.vertices, environment_mesh.faces[near], process=False)
    way, face = Rays(sheet).first_hits(points, np.array([[0.0, 0.0, 1.0]]), reach=float(body.extents[2]))
    way = np.where((face >= 0) & (np.asarray(sheet.face_normals)[face, 2] > CARRIES), way, 0.0)
    deepest = int(way.argmax())
    return float(way[deepest]), points[deepest]


def _remedy(
    object_mesh: trimesh.Trimesh,
    surroundings: ExactDistance,
    T_world_object: Float[np.ndarray, "4 4"],
    wrong_by: float,
    move: str,
) -> str:
    """Return the likely mistake if there is one, and the plain shift."""
    mistake = next(_mistakes(object_mesh, surroundings, T_world_object, wrong_by), None)
    return f"{mistake}; if not, {move}" if mistake else move


def _mistakes(
    object_mesh: trimesh.Trimesh, surroundings: ExactDistance, T_world_object: Float[np.ndarray, "4 4"], wrong_by: float
) -> Iterator[str]:
    """Yield the mistakes in pose or scan without which the object would touch its surroundings and not enter them.

    wrong_by: depth or distance [m] that a mistake must explain.
    """
    points = surface_lattice(np.asarray(object_mesh.triangles), spacing=QUICK_SPACING)[0]
    given = trimesh.transform_points(points, T_world_object)
    limit = float(np.clip(wrong_by / BETTER, SUPPORT_LIMIT, ROUGHLY))
    found: list[tuple[float, _Mistake]] = []
    for mistake in _mistakes_made(T_world_object):
        placed = trimesh.transform_points(points, mistake.pose)
        moved = placed - given  # against the surroundings as they are
        if (mistake.plain and wrong_by < PLAIN_MISTAKE) or np.linalg.norm(moved, axis=1).max() < FAR:
            continue
        hit = surroundings(placed)
        gap = float(np.abs(hit.distance).min())
        if gap <= limit and _carried(placed, hit, limit, mistake.turn):
            found.append((gap, mistake))
    for _, mistake in sorted(found, key=lambda entry: entry[0]):  # the best explanation first
        if deepest_overlap(object_mesh.copy().apply_transform(mistake.pose), surroundings)[0] <= limit:
            yield f"{mistake.question}: it would touch there"


def _carried(points: Float[np.ndarray, "n 3"], hit: ExactHit, limit: float, turn: Float[np.ndarray, "3 3"]) -> bool:
    """Return whether points lie on one side of what they touch within `limit` [m], and that is below them, when turned."""
    near = np.abs(hit.distance) <= 2 * limit
    normal = hit.normal[near].sum(axis=0)
    normal /= max(float(np.linalg.norm(normal)), SUPPORT_LIMIT)
    heights = (points - hit.closest[near].mean(axis=0)) @ normal
    up = np.sign(heights.mean()) * normal  # a sheet has no inside
    if min(-heights.min(), heights.max()) > 2 * limit or (turn @ up)[2] <= CARRIES:
        return False
    across = np.linalg.svd(normal[None])[2][1:]  # the plane that would carry them
    corners = hit.closest[near] @ across.T - (points.max(axis=0) + points.min(axis=0)) @ across.T / 2
    weights = np.vstack([corners.T, np.ones(len(corners))])
    return bool(nnls(weights, np.array([0.0, 0.0, 1.0]))[1] <= BALANCED)


@dataclass(frozen=True)
class _Mistake:
    """What may have been meant: a question, the pose in the surroundings as they are, and their turn to what they are."""

    question: str
    pose: Float[np.ndarray, "4 4"]
    turn: Float[np.ndarray, "3 3"]
    plain: bool


def _mistakes_made(pose: Float[np.ndarray, "4 4"]) -> Iterator[_Mistake]:
    """Yield the mistakes that are often made: in the unit or the order of a pose, and in the axes of a scan."""
    for unit, metres in POSE_UNITS.items():
        scaled = pose.copy()
        scaled[:3, 3] *= metres
        yield _Mistake(f"is the pose in {unit}? give its position in metres", scaled, np.eye(3), plain=True)
    transposed = pose.copy()
    transposed[:3, :3] = pose[:3, :3].T
    others = {"is the rotation of the pose transposed": transposed, "is the pose inverted": np.linalg.inv(pose)}
    for question, other in others.items():
        if not np.allclose(other, pose):
            remedy = "give T_world_object, which maps object to world"
            yield _Mistake(f"{question}? {remedy}", other, np.eye(3), plain=False)
    for question, degrees in (("upside down", 180), ("y-up", 90)):
        turn = trimesh.transformations.rotation_matrix(np.radians(degrees), [1, 0, 0])
        remedy = f"z points up: turn the environment by {degrees} degrees about x"
        yield _Mistake(f"is the scan {question}? {remedy}", np.linalg.inv(turn) @ pose, turn[:3, :3], plain=False)


ROOM = 12.0  # [m] longest side of surroundings that a hand works in; more is a hall, or another unit
SMALLEST_ENVIRONMENT = 0.1  # of the object's longest side: smaller surroundings are in another unit
KILOGRAM = 0.9995  # [kg] below it three digits of grams
HEAVIEST = 20e3  # [kg/m^3] platinum; a denser object has its mass in grams
LIGHTEST = 2.0  # [kg/m^3] a fifth of the lightest foam


def size_findings(object_mesh: trimesh.Trimesh, environment_mesh: trimesh.Trimesh, mass: float) -> list[Finding]:
    """Return both sizes [m] and the mass [kg] as understood; an error or a warning where they are not plausible."""
    size, room = object_mesh.extents, environment_mesh.extents
    length, width = float(size.max()), float(room.max())
    sides = " x ".join(f"{1e3 * side:.0f}" for side in size)
    around = " x ".join(f"{side:.2g}" for side in room)
    found = [
        Finding("note", "size", f"the object is {sides} mm, {_weight(mass)}"),
        Finding("note", "size", f"the surroundings are {around} m, {len(environment_mesh.faces)} triangles"),
    ]
    if not SHORTEST_OBJECT <= length <= LONGEST_OBJECT:
        sentence = f"the object is {length:.4g} m long; expected {SHORTEST_OBJECT:g} to {LONGEST_OBJECT:g} m"
        found.append(Finding("error", "units", sentence, _meant(length, SHORTEST_OBJECT, LONGEST_OBJECT)))
    elif width < SMALLEST_ENVIRONMENT * length:
        sentence = f"the surroundings are {width:.4g} m wide; expected more than the object, {length:.2g} m"
        found.append(Finding("error", "units", sentence, _meant(width, length, ROOM)))
    elif width > ROOM:
        level: Level = "error" if width > LONGEST_ENVIRONMENT else "warning"
        sentence = f"the surroundings are {width:.4g} m wide; expected at most {ROOM:g} m, as a room has"
        found.append(Finding(level, "units", sentence, _meant(width, length, ROOM)))
    density = mass / float(object_mesh.convex_hull.volume)
    if not LIGHTEST <= density <= HEAVIEST:
        sentence = f"the object weighs {mass:.3g} kg, {density:,.0f} kg/m^3; expected {LIGHTEST:g} to {HEAVIEST:g}"
        found.append(Finding("warning", "size", sentence, "give `mass` in kg"))
    return found


def _weight(mass: float) -> str:
    """Return a mass [kg] in the unit in which people would say it."""
    return f"{1e3 * mass:.3g} g" if mass < KILOGRAM else f"{mass:,.3g} kg" if mass < 1000 else f"{mass:,.0f} kg"


def _meant(metres: float, low: float, high: float) -> str:
    """Return the units in which a length is one from `low` to `high` [m], as a remedy."""
    others = {unit: factor for unit, factor in METRES_PER_UNIT.items() if unit != "m"}
    read_as = {unit: metres * factor for unit, factor in others.items()}
    fitting = [f"{unit} ({length:.3g} m)" for unit, length in read_as.items() if low <= length <= high]
    if fitting:
        return f"is it in another unit? pass `units` {' or '.join(fitting)}"
    given = [
        f"not {unit} ({metres / factor:.3g} m)" for unit, factor in others.items() if low <= metres / factor <= high
    ]
    if given:
        return f"is it in metres, {' or '.join(given)}? `units` is of both meshes: write them in the same one"
    return "scale it to metres"
