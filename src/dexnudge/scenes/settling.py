"""Measured supports made flat, an object brought to rest on them, and a motion brought into the plane that it slides on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.optimize import linprog
from scipy.sparse import coo_array, identity
from scipy.spatial.transform import Rotation

from dexnudge.geometry.exact_distance import Rays
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.geometry.surface_lattice import faces_near
from dexnudge.scenes.plane_fit import EXACT, STRAY
from dexnudge.scenes.supports import Support, facing_points, nearest_surface

BAND = 4.0  # standard deviations about the plane; beyond it a vertex is no noise
LEVEL = 1.2  # standard deviations of the mean over some twelve vertices: four of its own
UPRIGHT = 0.2  # cosine of a vertex's normal with the plane's from which it belongs to that surface, and not to a wall
ON_PLANE = 1e-7  # [m] a surface this near to its plane is left as it is
AROUND = 1.0  # [m] from the object up to which its supports are followed: a hand reaches less far
LOWEST_TRIANGLE = 1e-5  # [m] a lower one has no direction of its own


def snapped(
    surroundings: trimesh.Trimesh, supports: Sequence[Support], *, around: Float[np.ndarray, "3"]
) -> trimesh.Trimesh:
    """Return surroundings [m, world] whose vertices within the noise of a support lie on its plane.

    Followed up to 1 m `around` a point, over gaps and holes. Surroundings that are flat already are returned as they are.
    """
    vertices = np.array(surroundings.vertices, dtype=np.float64)
    nearest = np.full(len(vertices), np.inf)
    placed = vertices.copy()
    within = np.abs(vertices - around).max(axis=1) <= AROUND
    for support in supports:
        height = support.height(vertices)
        near = within & (np.abs(height) <= STRAY * max(support.noise, EXACT))
        mine = np.flatnonzero(near & _belongs(surroundings, support, height, near))
        mine = mine[np.abs(height[mine]) < nearest[mine]]
        nearest[mine] = np.abs(height[mine])
        placed[mine] = vertices[mine] - height[mine, None] * support.normal
    moved = np.isfinite(nearest)
    if not (nearest[moved] > ON_PLANE).any():
        return surroundings
    faces = np.asarray(surroundings.faces)
    kept = ~(moved[faces].all(axis=1) & (least_heights(placed[faces]) < LOWEST_TRIANGLE))
    made = trimesh.Trimesh(placed, faces[kept], process=False)
    made.metadata.update(surroundings.metadata)
    if "origin" in made.metadata:
        made.metadata["origin"] = made.metadata["origin"][kept]
    return made


def _belongs(
    mesh: trimesh.Trimesh, support: Support, height: Float[np.ndarray, " n"], near: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Return which vertices are of a support's surface: in its band, turned like it, and on it on average with others.

    A step or a lip has the same few millimetres as the noise, but neighbours have them alike; so what decides is the mean
    height of a vertex and those up to two edges away. Not so in surfaces fused from depth: there the errors of a view are
    alike over centimetres.
    """
    faces = np.asarray(mesh.faces)
    faces = faces[near[faces].any(axis=1)]
    used, corner = np.unique(faces, return_inverse=True)
    corner, count = corner.reshape(-1, 3), len(used)
    corners = np.asarray(mesh.vertices)[faces]
    lean = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack([np.bincount(corner.ravel(), np.repeat(axis, 3), count) for axis in lean.T], axis=1)
    along = total @ support.normal
    noise = max(support.noise, EXACT)
    own, inside = height[used], near[used]
    alike = inside & (along > UPRIGHT * np.linalg.norm(total, axis=1))
    pairs = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]])
    links = coo_array((np.ones(2 * len(pairs)), (pairs.ravel("F"), pairs[:, ::-1].ravel("F"))), shape=(count, count))
    links = links.tocsr() + identity(count, format="csr")
    mean = own
    for _ in range(2):
        mean = (links @ (alike * mean)) / np.maximum(links @ alike.astype(float), 1.0)
    level = np.abs(mean) <= (BAND if "origin" in mesh.metadata else LEVEL) * noise
    belongs = alike & level & (np.abs(own) <= BAND * noise)
    for _ in range(2):  # stray vertices, and such that noise has turned, amid others that belong
        among, others = links @ belongs.astype(float) - belongs, links @ np.ones(count) - 1.0
        belongs |= inside & (others > 0) & (among == others)
        belongs |= inside & level & (np.abs(own) <= BAND * noise) & (among > 0.5 * others) & (along > 0)
    found = np.zeros(len(height), dtype=bool)
    found[used] = belongs
    return found & near


def least_heights(triangles: Float[np.ndarray, "face 3 3"]) -> Float[np.ndarray, " face"]:
    """Return the least height of each triangle [m]."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return np.asarray(np.divide(area, longest, out=np.zeros_like(area), where=longest > 0))


MOST_SHIFT = 0.005  # [m] that an object is raised or lowered; more is another pose
MOST_TURN = np.radians(3.0)  # that it is tilted
MOST_SLOPE = np.radians(15.0)  # between a motion and its support; a steeper one is meant to leave it, or to run into it
IDLE_TURN = 0.002  # [m/rad] that a turn must lower the object by: a round one does not roll
FLAT = 1e-7  # [m] a vertex this near to a plane lies on it
IN_PLACE = 2e-5  # [m] an object that would move less rests already
ALONG = 1e-6  # sine of an angle between motion and support that is rounding
ALMOST = 0.999  # of the most that it is tilted: it would tilt on
ROUNDS = 4  # of the linearised fall
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class Settled:
    """A resting object.

    Attributes:
        T_world_object: where it rests. shift: by which its centre of mass rose [m], negative where it fell. turn [rad].
        rests: whether it came to rest within 5 mm and 3 deg; otherwise it was raised or lowered at most.
    """

    T_world_object: Float[np.ndarray, "4 4"]
    shift: float
    turn: float
    rests: bool


def settle(
    mesh: trimesh.Trimesh,
    surroundings: trimesh.Trimesh,
    T_world_object: Float[np.ndarray, "4 4"],
    supports: Sequence[Support] = (),
) -> Settled:
    """Return the object [m, object frame] at rest on surroundings [m, world]: lowered or raised, and tilted.

    It comes to rest where its centre of mass is lowest while none of its points is below what lies under it: for small
    turns a linear program in one shift and two turns, solved again about each new pose. It does not move sideways, nor
    turn about the vertical. One that rests already keeps its pose to the last bit. What is within the noise of one of the
    `supports` below it counts as its plane: no stray spike of a scan tilts the object.
    """
    given = np.asarray(T_world_object, dtype=np.float64)
    pose = given.copy()
    reach = MOST_SHIFT + float(np.sin(MOST_TURN)) * 0.5 * float(np.linalg.norm(mesh.extents))
    body = mesh.copy().apply_transform(given)
    near = faces_near(surroundings, body.bounds + np.array([[-2 * reach], [2 * reach]]))
    if len(near) == 0:
        return Settled(given, 0.0, 0.0, rests=False)
    ground = _Ground(surroundings, near, supports, reach=2 * reach)
    T_object_world = np.linalg.inv(given)
    points = facing_points(body, DOWN) @ T_object_world[:3, :3].T + T_object_world[:3, 3]  # object frame
    centre = centre_of_mass(mesh)
    for _ in range(ROUNDS):
        world = points @ pose[:3, :3].T + pose[:3, 3]
        gap = ground.gap(world)
        carried = np.isfinite(gap)
        middle = pose[:3, :3] @ centre + pose[:3, 3]
        arm = world[carried] - middle
        if not carried.any():
            return Settled(given, 0.0, 0.0, rests=False)
        turns = np.stack([arm[:, 1], -arm[:, 0]], axis=1)
        step = linprog(
            [1.0, *4 * [IDLE_TURN]],
            A_ub=-np.concatenate([np.ones((len(arm), 1)), turns, -turns], axis=1),
            b_ub=gap[carried],
            bounds=[(-2 * reach, 2 * reach), *4 * [(0.0, MOST_TURN)]],
            method="highs",
        )
        if not step.success:
            return Settled(given, 0.0, 0.0, rests=False)
        found = np.asarray(step.x)
        rise, about_x, about_y = float(found[0]), float(found[1] - found[3]), float(found[2] - found[4])
        move = np.eye(4)
        move[:3, :3] = Rotation.from_rotvec([about_x, about_y, 0.0]).as_matrix()
        move[:3, 3] = middle - move[:3, :3] @ middle + np.array([0.0, 0.0, rise])
        pose = move @ pose
        if max(abs(rise), np.abs([about_x, about_y]).max() * np.linalg.norm(arm, axis=1).max()) < 1e-7:
            break
    shift = float((pose[:3, :3] @ centre + pose[:3, 3] - given[:3, :3] @ centre - given[:3, 3])[2])
    turn = float(Rotation.from_matrix(pose[:3, :3] @ given[:3, :3].T).magnitude())
    moved = points @ (pose - given)[:3, :3].T + (pose - given)[:3, 3]
    if np.linalg.norm(moved, axis=1).max() < IN_PLACE:
        return Settled(given, 0.0, 0.0, rests=True)
    if abs(shift) > MOST_SHIFT or turn > ALMOST * MOST_TURN:
        world = points @ given[:3, :3].T + given[:3, 3]
        return _touching(given, ground.gap(world))
    return Settled(pose, shift, turn, rests=True)


def _touching(given: Float[np.ndarray, "4 4"], gap: Float[np.ndarray, " n"]) -> Settled:
    """Return an object that would tip over, raised or lowered until it touches what is below it."""
    shift = -float(gap.min())
    pose = given.copy()
    if IN_PLACE < abs(shift) <= MOST_SHIFT:
        pose[2, 3] += shift
    return Settled(pose, float(pose[2, 3] - given[2, 3]), 0.0, rests=False)


class _Ground:
    """What may carry an object, without the stray spikes of a scan: what stands on a support's plane counts as it."""

    def __init__(
        self,
        surroundings: trimesh.Trimesh,
        near: Int[np.ndarray, " near"],
        supports: Sequence[Support],
        *,
        reach: float,
    ) -> None:
        vertices, faces = np.asarray(surroundings.vertices), np.asarray(surroundings.faces)[near]
        self._rays = Rays(trimesh.Trimesh(vertices, faces, process=False))
        self._normals, self._reach = np.asarray(surroundings.face_normals)[near], reach
        rough = [support for support in supports if support.side == "below" and support.noise > EXACT]
        self._planes = [(each, (np.abs(each.height(vertices)) <= FLAT)[faces].any(axis=1)) for each in rough]

    def gap(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return how far below each point what could carry it lies [m]: negative in it, infinite where there is nothing."""
        gap, face = nearest_surface(points, self._rays, self._normals, DOWN, reach=self._reach)
        for support, touches in self._planes:
            to_plane = support.height(points) / support.normal[2]
            stray = (face >= 0) & touches[face] & (np.abs(gap - to_plane) <= STRAY * support.noise)
            gap = np.where(stray, to_plane, gap)
        return gap


def along_support(motion: Float[np.ndarray, "3"], support: Support) -> Float[np.ndarray, "3"]:
    """Return a unit motion in the plane of a support; the one given where it is already, or is meant to leave it."""
    rise = float(motion @ support.normal)
    if abs(rise) <= ALONG or abs(rise) > np.sin(MOST_SLOPE):
        return motion
    along = motion - rise * support.normal
    return np.asarray(along / np.linalg.norm(along))
