"""An object resting on the plane z = 0, turned about the vertical, with the size of what it covers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float, Shaped
from scipy.spatial import ConvexHull

from dexnudge.errors import SceneError
from dexnudge.geometry.mesh_repair import solid_angles
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.scenes.boxes import shift, turn

SAME_FACE_ANGLE = 5.0  # [deg] hull triangles this close in direction count as one face: scans are never quite flat
TIE = 0.02  # two faces whose sizes differ by less than this fraction are equally stable
STANDING_HEIGHT = 1e-3  # [m] over the lowest vertex up to which an object that stands touches the plane
STEADY = 1e-3  # [m] that its supports reach beyond its centre of mass on every side
PAIRS_AT_ONCE = 4_000_000  # comparisons made in one array
EDGE_TOLERANCE = 1e-9  # barycentric; the foot of the centre of mass may lie on the edge between two triangles


def resting_pose(mesh: trimesh.Trimesh) -> Float[np.ndarray, "4 4"]:
    """Return the pose of the object (object frame to a frame on the support plane) when it lies on its most stable face.

    The plane is z = 0, z up; the lowest vertices touch it exactly; the centre of the bounding box is above the
    origin; the long side of the smallest rectangle around the footprint lies along x.

    A triangle of the convex hull can carry the object where the centre of mass stands over it. Among those the
    most stable is the one whose face (all hull triangles within 5 deg of its direction) fills the largest solid
    angle seen from the centre of mass, the chance of landing there of an object thrown at random without rolling.
    Ties go to the face that points most along the object's -z, then -y, then -x.

    Raises:
        SceneError: no face can carry the object.
    """
    rotation = _face_down(_most_stable_direction(mesh))
    placed = np.asarray(mesh.convex_hull.vertices) @ rotation.T
    # All vertices, not the hull's: the lowest one decides to the last digit.
    return _placed(np.asarray(mesh.vertices), long_side_along_x(placed[:, :2]) @ rotation)


def standing_pose(mesh: trimesh.Trimesh) -> Float[np.ndarray, "4 4"] | None:
    """Return the pose of the object on its end, the longest side of its resting pose up; None where it cannot stand so.

    It stands where its centre of mass is 1 mm inside of what is within 1 mm of the plane. Of the two ends, the one whose
    supports reach farther about it. Plane, origin and axes as in `resting_pose`.
    """
    lying = resting_pose(mesh)
    placed = trimesh.transform_points(mesh.vertices, lying)
    centre = trimesh.transform_points(centre_of_mass(mesh)[None], lying)[0]
    best, steadiest = None, STEADY
    for sign in (1.0, -1.0):
        end = np.array([[0.0, 0.0, -sign], [0.0, 1.0, 0.0], [sign, 0.0, 0.0]])  # of the long side, up is +x or -x
        turned, over = placed @ end.T, (centre @ end.T)[:2]
        foot = turned[turned[:, 2] < turned[:, 2].min() + STANDING_HEIGHT, :2]
        if len(foot) < 3 or np.linalg.matrix_rank(foot - foot[0], tol=STEADY) < 2:
            continue
        hull = ConvexHull(foot)
        steady = float(-(hull.equations[:, :2] @ over + hull.equations[:, 2]).max())
        if steady > steadiest * (1 + TIE):
            rotation = long_side_along_x(turned[ConvexHull(turned[:, :2]).vertices, :2]) @ end
            best, steadiest = rotation, steady
    return None if best is None else _placed(placed, best) @ lying


def _placed(vertices: Float[np.ndarray, "n 3"], rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4 4"]:
    """Return the pose that turns the vertices so, their lowest on z = 0 and the centre of their box above the origin."""
    turned = vertices @ rotation.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = [-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]]
    return pose


def _most_stable_direction(mesh: trimesh.Trimesh) -> Float[np.ndarray, "3"]:
    """Outward unit normal, object frame, of the hull triangle that the object rests on."""
    hull = mesh.convex_hull
    corners = np.asarray(hull.triangles) - centre_of_mass(mesh)
    normals = np.asarray(hull.face_normals)
    angles = np.abs(solid_angles(corners))
    height = np.einsum("ij,ij->i", corners[:, 0], normals)
    feet = normals * height[:, None]
    inside = trimesh.triangles.points_to_barycentric(corners, feet).min(axis=1) >= -EDGE_TOLERANCE
    candidates = np.flatnonzero(inside & (height > 0))
    if len(candidates) == 0:
        raise SceneError("the object has no face that it can rest on; expected a closed body; check its mesh")
    least = np.cos(np.radians(SAME_FACE_ANGLE))
    size = np.concatenate([(normals[some] @ normals.T >= least) @ angles for some in _parts(candidates, len(normals))])
    best = candidates[size >= (1 - TIE) * size.max()]
    # Rounded so that noise in the last digits does not decide between equal directions.
    keys = np.round(normals[best], 6)
    return normals[best[np.lexsort((keys[:, 0], keys[:, 1], keys[:, 2]))[0]]]


def _parts(rows: Shaped[np.ndarray, "n ..."], others: int) -> list[Shaped[np.ndarray, "part ..."]]:
    """Split rows of which each is compared with so many others, to bound memory."""
    return np.array_split(rows, 1 + len(rows) * others // PAIRS_AT_ONCE)


def _face_down(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Smallest rotation that turns `normal` to -z."""
    down = np.array([0.0, 0.0, -1.0])
    cosine = float(normal @ down)
    if cosine < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    v = np.cross(normal, down)
    skew = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + skew + skew @ skew / (1 + cosine)


def long_side_along_x(footprint: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3 3"]:
    """Rotation about z that lays the long side of the smallest rectangle around the footprint along x.

    One side of that rectangle lies along an edge of the footprint's hull, so all edges are tried. Of the two ways
    round, the smaller turn.
    """
    outline = footprint[ConvexHull(footprint).vertices]
    edges = np.roll(outline, -1, axis=0) - outline
    directions = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    sides = np.concatenate(
        [
            [np.ptp(outline @ some.T, axis=0), np.ptp(outline @ np.stack([-some[:, 1], some[:, 0]]), axis=0)]
            for some in _parts(directions, len(outline))
        ],
        axis=1,
    )
    best = int(np.argmin(np.round(sides.prod(axis=0), 12)))
    angle = np.arctan2(directions[best, 1], directions[best, 0])
    if sides[1, best] > sides[0, best]:
        angle += np.pi / 2
    angle -= np.pi * np.round(angle / np.pi)
    c, s = np.cos(-angle), np.sin(-angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class RestingObject:
    """The object on z = 0, the centre of its bounding box above the origin.

    `pose`: (4, 4) object frame to world. `size`: (3,) of the bounding box in the world [m]. `yaw` [rad].
    """

    mesh: trimesh.Trimesh
    pose: Float[np.ndarray, "4 4"]
    size: Float[np.ndarray, "3"]
    yaw: float

    def at(self, x: float, y: float, z: float = 0.0) -> Float[np.ndarray, "4 4"]:
        """Return the pose with the centre of the bounding box above (x, y) and the lowest point at height z [m]."""
        return shift(x, y, z) @ self.pose

    def footprint(self) -> Float[np.ndarray, "n 2"]:
        """World x and y of all vertices of the convex hull."""
        hull = np.asarray(self.mesh.convex_hull.vertices)
        return (hull @ self.pose[:3, :3].T + self.pose[:3, 3])[:, :2]


def place_at_rest(mesh: trimesh.Trimesh, yaw: float) -> RestingObject:
    """Return the object on its most stable face; at `yaw` = 0 its long side is along x."""
    pose = turn(yaw) @ resting_pose(mesh)
    placed = np.asarray(mesh.vertices) @ pose[:3, :3].T + pose[:3, 3]
    low, high = placed.min(axis=0), placed.max(axis=0)
    centred = shift(-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]) @ pose
    return RestingObject(mesh, centred, high - low, float(yaw))
