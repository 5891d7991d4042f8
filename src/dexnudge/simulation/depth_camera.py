"""Depth images of a known scene, as a structured-light camera would measure them.

Depth is found by rays against the triangles (Warp), not by OpenGL: it then runs on every machine, also without a display,
a GPU or a GL library, has no near and far plane, and is exact to a micrometre before the noise is added.

What is known of such cameras, each from measurements of the first Kinect:
- axial noise: K. Nguyen, S. Izadi, D. Lovell, *Modeling Kinect sensor noise for improved 3D reconstruction and tracking*,
  3DIMPVT 2012: sigma_z = 0.0012 + 0.0019 (z - 0.4)^2 [m], more where the surface is seen at over 60 degrees:
  + 0.0001 / sqrt(z) theta^2 / (pi/2 - theta)^2; lateral noise: sigma_l = 0.8 + 0.035 theta / (pi/2 - theta) [px].
- quantisation: K. Khoshelham, S. O. Elberink, *Accuracy and resolution of Kinect depth data for indoor mapping
  applications*, Sensors 12 (2012): disparity comes in steps, so that depths stand 2.85e-3 z^2 [m] apart.
- what is not measured: the projector's shadow, where its pattern does not fall; surfaces at grazing angles, to which
  Nguyen's measurements do not reach; and edges, where a pixel's window of correlation holds two depths.
Not in it: noise that neighbouring pixels share, errors of calibration, and surfaces that shine or let light through.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter, minimum_filter

from dexnudge.geometry.exact_distance import Rays
from dexnudge.geometry.surface_lattice import surface_lattice
from dexnudge.perception.depth_view import DepthView
from dexnudge.scenes.boxes import box, joined
from dexnudge.scenes.scene import Scene

FARTHEST = 6.0  # [m] no ray is followed beyond
ROOM, FLOOR_BELOW = 4.0, 0.7  # [m] size of the room that a scene stands in, and its floor below the surroundings
OFF_SURFACE = 1e-4  # [m] before a surface, where rays from it start: they must not meet it again
DISPARITY_STEP = 2.85e-3  # [1/m] of inverse depth, Khoshelham and Elberink 2012
STEEP = np.radians(60.0)  # from which axial noise grows with the angle, Nguyen et al. 2012
GRAZING = np.radians(80.0)  # beyond it nothing is measured
WINDOW = 3.0  # [px] across which an edge is looked for, diagonally
EDGE = 0.02  # [m] between the depths of neighbouring pixels, beyond what the slope of their surface explains


@dataclass(frozen=True, kw_only=True)
class DepthCamera:
    """A structured-light camera; unless given, the size of the first Kinect.

    Attributes:
        width, height: of the image [px]. focal: length [px], of both axes; the optical axis passes through the centre.
        baseline: from the camera to its projector, along the image's x axis [m].
        nearest: least depth that is measured [m].
        unit: length of one step of the 16-bit image [m].
        noise: factor of the axial and lateral noise; with 0 depths are only quantised.
    """

    width: int = 640
    height: int = 480
    focal: float = 585.0
    baseline: float = 0.075
    nearest: float = 0.3
    unit: float = 0.001
    noise: float = 1.0

    @property
    def centre(self) -> tuple[float, float]:
        """Principal point (cx, cy) [px]."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    def directions(self) -> Float[np.ndarray, "height width 3"]:
        """Return the ray of each pixel in the camera's frame (x right, y down, z forward), scaled to z = 1."""
        x = (np.arange(self.width) - self.centre[0]) / self.focal
        y = (np.arange(self.height) - self.centre[1]) / self.focal
        return np.stack([*np.meshgrid(x, y), np.ones((self.height, self.width))], axis=-1)


KINECT = DepthCamera()


@dataclass(frozen=True, eq=False)
class SeenSurface:
    """What each pixel of a camera sees, without noise.

    depth: along z [m], 0 where nothing is. normal: unit, towards the camera, in its frame. incidence: angle between the ray
    and the normal [rad]. on_object: whether it is the object. lit: whether the projector's pattern falls there.
    """

    depth: Float[np.ndarray, "height width"]
    normal: Float[np.ndarray, "height width 3"]
    incidence: Float[np.ndarray, "height width"]
    on_object: Bool[np.ndarray, "height width"]
    lit: Bool[np.ndarray, "height width"]


class DepthRenderer:
    """Renders one scene from anywhere; the tree of its triangles is built once.

    room: whether the scene stands in a room of 4 x 4 m with a floor 0.7 m below it. A camera that looks past a table at
    nothing could not tell that the space before it is free.
    """

    def __init__(self, scene: Scene, camera: DepthCamera = KINECT, *, room: bool = True) -> None:
        self.camera = camera
        body = scene.object_in_world()
        parts = [body, scene.environment_mesh, *([_room_around(body, scene.environment_mesh)] if room else [])]
        mesh = joined(parts)
        self._object_faces = len(body.faces)
        self._rays, self._normals = Rays(mesh), np.asarray(mesh.face_normals)

    def render(self, T_world_camera: Float[np.ndarray, "4 4"]) -> SeenSurface:
        """Return what the pixels of a camera at T_world_camera (x right, y down, z forward) see."""
        rotation, position = T_world_camera[:3, :3], T_world_camera[:3, 3]
        local = self.camera.directions()
        stretch = np.linalg.norm(local, axis=-1)
        unit = (local / stretch[..., None]).reshape(-1, 3)
        way, face = self._rays.first_hits(np.tile(position, (len(unit), 1)), unit @ rotation.T, reach=FARTHEST)
        hit = face >= 0
        normal = np.where(hit[:, None], self._normals[face] @ rotation, -unit)
        cosine = np.einsum("px,px->p", normal, unit)
        normal = np.where(cosine[:, None] > 0, -normal, normal)
        shape = local.shape[:2]
        return SeenSurface(
            depth=np.where(hit, way, 0.0).reshape(shape) / stretch,
            normal=normal.reshape(*shape, 3),
            incidence=np.arccos(np.clip(np.abs(cosine), 0.0, 1.0)).reshape(shape),
            on_object=(hit & (face < self._object_faces)).reshape(shape),
            lit=(hit & self._lit(way, unit @ rotation.T, position, rotation)).reshape(shape),
        )

    def view(self, T_world_camera: Float[np.ndarray, "4 4"], generator: np.random.Generator) -> DepthView:
        """Return what the camera measures there, and which pixels the object's are."""
        seen, camera = self.render(T_world_camera), self.camera
        (cx, cy), depth = camera.centre, measured_depth(seen, camera, generator)
        return DepthView(depth, camera.focal, camera.focal, cx, cy, T_world_camera, mask=seen.on_object)

    def _lit(
        self,
        way: Float[np.ndarray, " pixel"],
        directions: Float[np.ndarray, "pixel 3"],
        position: Float[np.ndarray, "3"],
        rotation: Float[np.ndarray, "3 3"],
    ) -> Bool[np.ndarray, " pixel"]:
        """Whether the projector, beside the camera, sees the same points."""
        points = position + np.maximum(way - OFF_SURFACE, 0.0)[:, None] * directions
        to_projector = position + self.camera.baseline * rotation[:, 0] - points
        distance = np.linalg.norm(to_projector, axis=1)
        blocked_at, _ = self._rays.first_hits(points, to_projector / distance[:, None], reach=2 * FARTHEST)
        return np.asarray(blocked_at >= distance)


def _room_around(body: trimesh.Trimesh, surroundings: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the walls, floor and ceiling of a room around a scene."""
    (x, y, _), low = body.bounds.mean(axis=0), float(surroundings.bounds[0, 2]) - FLOOR_BELOW
    half = ROOM / 2
    return box((x - half, y - half, low), (x + half, y + half, low + ROOM))


def axial_noise(
    depth: Float[np.ndarray, "*pixel"], incidence: Float[np.ndarray, "*pixel"]
) -> Float[np.ndarray, "*pixel"]:
    """Return the standard deviation of depth [m] at depths [m] and angles of incidence [rad] (Nguyen et al. 2012)."""
    angle = np.clip(incidence, 0.0, GRAZING)
    steep = 0.0001 / np.sqrt(np.maximum(depth, 0.1)) * angle**2 / (np.pi / 2 - angle) ** 2
    return 0.0012 + 0.0019 * (depth - 0.4) ** 2 + np.where(angle > STEEP, steep, 0.0)


def lateral_noise(incidence: Float[np.ndarray, "*pixel"]) -> Float[np.ndarray, "*pixel"]:
    """Return the standard deviation in the image [px] at angles of incidence [rad] (Nguyen et al. 2012)."""
    angle = np.clip(incidence, 0.0, GRAZING)
    return 0.8 + 0.035 * angle / (np.pi / 2 - angle)


def measured_depth(
    seen: SeenSurface, camera: DepthCamera, generator: np.random.Generator
) -> Float[np.ndarray, "height width"]:
    """Return the depth image [m] that a camera measures of what it sees; 0 = not measured.

    Lateral noise lets a pixel look at the surface of a neighbour, whose plane is then met by the pixel's own ray: it moves
    edges and leaves planes as they are, on which the axial noise was measured. That noise includes the quantisation, so
    what is added has the rest of its variance: sigma^2 = sigma_z^2 - (step^2 + unit^2) / 12.
    """
    rows, columns = _shifted_pixels(seen, camera, generator)
    surface, normal = seen.depth[rows, columns], seen.normal[rows, columns]
    incidence, directions = seen.incidence[rows, columns], camera.directions()
    towards = np.einsum("rcx,rcx->rc", normal, directions)
    offset = surface * np.einsum("rcx,rcx->rc", normal, directions[rows, columns])
    depth = np.divide(offset, towards, out=surface.copy(), where=towards < -np.cos(GRAZING))
    step = DISPARITY_STEP * depth**2
    rest = np.maximum(axial_noise(depth, incidence) ** 2 - (step**2 + camera.unit**2) / 12, 0.0)
    depth = depth + camera.noise * np.sqrt(rest) * generator.standard_normal(depth.shape)
    measured = (surface > 0) & (incidence < GRAZING) & seen.lit & ~_at_edges(seen, camera) & (depth >= camera.nearest)
    inverse = DISPARITY_STEP * np.rint(1.0 / (DISPARITY_STEP * np.where(measured, depth, 1.0)))
    return np.where(measured, camera.unit * np.rint(1.0 / (camera.unit * inverse)), 0.0)


def _shifted_pixels(
    seen: SeenSurface, camera: DepthCamera, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the pixel whose surface each pixel looks at."""
    shape = seen.depth.shape
    shift = camera.noise * lateral_noise(seen.incidence) * generator.standard_normal((2, *shape))
    row, column = np.indices(shape) + np.rint(shift).astype(np.int64)
    return np.clip(row, 0, shape[0] - 1), np.clip(column, 0, shape[1] - 1)


def _at_edges(seen: SeenSurface, camera: DepthCamera) -> Bool[np.ndarray, "height width"]:
    """Pixels whose eight neighbours' depths differ by more than the slope of their surface explains."""
    depth = np.where(seen.depth > 0, seen.depth, FARTHEST)
    jump = maximum_filter(depth, size=3) - minimum_filter(depth, size=3)
    across = WINDOW * depth / camera.focal  # [m] on a surface that faces the camera
    return np.asarray(jump > EDGE + across * np.tan(np.minimum(seen.incidence, GRAZING)))


def depth_views(
    scene: Scene, generator: np.random.Generator, *, num: int = 3, camera: DepthCamera = KINECT
) -> list[DepthView]:
    """Return what a camera measures of a scene from `num` places, with the object's mask in each."""
    renderer = DepthRenderer(scene, camera)
    return [renderer.view(pose, generator) for pose in camera_poses(scene, num=num)]


AZIMUTHS = 12  # around the object
ELEVATIONS = (15.0, 30.0, 45.0, 60.0)  # [deg] above the horizon
DISTANCES = (0.55, 0.7)  # [m] from the object
AROUND = 0.15  # [m] of the surroundings around the object that are to be seen
SPACING = 0.01  # [m] between the points that are to be seen
SEEN_AT = np.cos(np.radians(75.0))  # least cosine between a surface's normal and the way to the camera
OBJECT_SHARE = 2 / 3  # of the object's points that the best pose sees: what every chosen one sees at least
FARTHEST_SEEN = 4.0  # [m] no ray is followed beyond
CAMERA_ROOM = 0.1  # [m] that a camera keeps from everything


def camera_poses(scene: Scene, *, num: int = 3) -> list[Float[np.ndarray, "4 4"]]:
    """Return `num` poses T_world_camera, 0.55 or 0.7 m from the object, that together see most of it and around it.

    Taken one after another: the one that sees most points of the object, and of the surroundings that face it, which no
    earlier one has seen (a greedy next-best view); so in front of a shelf, and around a table. None is taken that sees much
    less of the object than another one does. Fewer where there is no more room.
    """
    body = scene.object_in_world()
    points, normals, own = _points_to_see(body, scene.environment_mesh)
    rays, centre = Rays(joined([body, scene.environment_mesh])), body.bounds.mean(axis=0)
    candidates, seen = [], []
    for position in _positions(centre, scene.motion):
        to_camera = position - points
        distance = np.linalg.norm(to_camera, axis=1)
        directions = to_camera / distance[:, None]
        free, _ = rays.first_hits(points + OFF_SURFACE * normals, directions, reach=FARTHEST_SEEN)
        visible = (free >= distance) & (np.einsum("px,px->p", normals, directions) > SEEN_AT)
        around, _ = rays.first_hits(
            np.tile(position, (6, 1)), np.concatenate([np.eye(3), -np.eye(3)]), reach=FARTHEST_SEEN
        )
        if around.min() >= CAMERA_ROOM:
            candidates.append(looking_at(centre, position))
            seen.append(visible)
    of_object = [int(visible[:own].sum()) for visible in seen]
    enough = OBJECT_SHARE * max(of_object, default=0)
    candidates = [pose for pose, number in zip(candidates, of_object, strict=True) if number >= enough]
    seen = [visible for visible, number in zip(seen, of_object, strict=True) if number >= enough]
    chosen: list[int] = []
    missing = np.ones(len(points), dtype=bool)
    while len(chosen) < min(num, len(candidates)):
        gain = [int((visible & missing).sum()) if index not in chosen else -1 for index, visible in enumerate(seen)]
        chosen.append(int(np.argmax(gain)))
        missing &= ~seen[chosen[-1]]
    return [candidates[index] for index in chosen]


def looking_at(target: Float[np.ndarray, "3"], position: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return T_world_camera of an upright camera at `position` [m] that looks at `target` [m], not from straight above."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = position
    return pose


def _positions(centre: Float[np.ndarray, "3"], motion: Float[np.ndarray, "3"]) -> Sequence[Float[np.ndarray, "3"]]:
    """Places around the object, the first in the direction of its motion."""
    azimuths = np.arctan2(motion[1], motion[0]) + 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    turned = np.stack([np.cos(azimuths), np.sin(azimuths)], axis=1)
    return [
        centre + distance * np.array([*(np.cos(angle) * direction), np.sin(angle)])
        for distance in DISTANCES
        for angle in np.radians(ELEVATIONS)
        for direction in turned
    ]


def _points_to_see(
    body: trimesh.Trimesh, surroundings: trimesh.Trimesh
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], int]:
    """Points with normals, evenly spread over the object and over what faces it; the number of those on the object."""
    own, face = surface_lattice(np.asarray(body.triangles), spacing=SPACING)
    centre, (low, high) = body.bounds.mean(axis=0), body.bounds + np.array([[-AROUND], [AROUND]])
    corners, others = np.asarray(surroundings.triangles), np.asarray(surroundings.face_normals)
    near = np.flatnonzero(((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1))
    around, other_face = surface_lattice(corners[near], spacing=SPACING)
    normals = others[near][other_face]
    facing = np.einsum("px,px->p", normals, centre - around) > 0
    kept = facing & ((around >= low) & (around <= high)).all(axis=1)
    return np.concatenate([own, around[kept]]), np.concatenate([body.face_normals[face], normals[kept]]), len(own)
