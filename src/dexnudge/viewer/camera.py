"""A pinhole camera: where it stands so that object, hand and contacts are seen, and which walls become glass for it."""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float

from dexnudge.jobs.cached import cached_per_instance
from dexnudge.viewer.trace_kernel import first_hits, warp_mesh
from dexnudge.viewer.visual_scene import VisualScene

TAN_HALF_HEIGHT = 0.26  # tangent of half the vertical angle of view (29 deg in all): little perspective distortion
FILLED = 0.76  # of the picture's width or height that the framed points take; the rest shows the surroundings


@dataclass(frozen=True, eq=False)
class Camera:
    """Position [m] and axes in the world; a pixel's ray goes along forward + x tan_width right + y tan_height up.

    x runs from -1 (left) to 1, y from -1 (bottom) to 1.
    """

    position: Float[np.ndarray, "3"]
    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    forward: Float[np.ndarray, "3"]
    tan_width: float
    tan_height: float

    @property
    def azimuth(self) -> float:
        """Direction from what is seen to the camera, from x towards y [rad]."""
        return float(np.arctan2(-self.forward[1], -self.forward[0]))

    @property
    def elevation(self) -> float:
        """The same above the horizon [rad]."""
        return float(np.arcsin(-self.forward[2]))

    def rays(self, size: tuple[int, int]) -> Float[np.ndarray, "pixel 3"]:
        """Return unit directions through the centres of all pixels of a picture (width, height), row by row from the top."""
        width, height = size
        x = (np.arange(width) + 0.5) / width * 2 - 1
        y = 1 - (np.arange(height) + 0.5) / height * 2
        rays = (
            self.forward
            + (self.tan_width * x)[None, :, None] * self.right
            + (self.tan_height * y)[:, None, None] * self.up
        ).reshape(-1, 3)
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def framing_camera(
    points: Float[np.ndarray, "n 3"],
    *,
    azimuth: float,
    elevation: float,
    aspect: float,
    tangent: float = TAN_HALF_HEIGHT,
    filled: float = FILLED,
) -> Camera:
    """Return the nearest camera in a given direction that sees all `points` [m] with a margin.

    Args:
        points: what must be in view [m].
        azimuth: direction from the points to the camera, from x towards y [rad].
        elevation: the same above the horizon [rad]; below a right angle.
        aspect: width of the picture over its height.
        tangent: of half the vertical angle of view; the smaller, the less perspective.
        filled: share of the picture's width or height that the points take.
    """
    backward = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.cross([0.0, 0.0, 1.0], backward)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(backward, right), backward])
    local = points @ axes.T
    tangents = np.array([tangent * aspect, tangent])
    # A point is in view where |x - x_camera| <= tangent (z_camera - z): two planes for each axis.
    reach = filled * tangents
    high = (local[:, :2] + reach * local[:, 2:]).max(axis=0)
    low = (local[:, :2] - reach * local[:, 2:]).min(axis=0)
    distance = ((high - low) / (2 * reach)).max()
    position = np.array([*(high + low) / 2, distance])
    return Camera(position @ axes, right, axes[1], -backward, float(tangents[0]), float(tangents[1]))


AZIMUTHS = 12  # candidate directions around the object
ELEVATIONS = (20.0, 38.0, 58.0)  # [deg] above the horizon
COARSE_HEIGHT = 48  # pixels of the trial pictures
GLASS_HEIGHT = 120  # pixels of the picture that finds what stands in front
GLASS_SHARE = {"object": 0.01, "hand": 0.06}  # of its pixels: a wall that hides less of both stays solid
CONTACT_ROOM = 0.006  # [m] a contact lies between two surfaces; this much in front of it does not hide it
MAX_WALLS = 8  # surfaces of the environment that are looked through
FARTHER = (
    4.0  # times as far away are trial cameras where an arm is to be seen: it takes that much more room than a hand
)
WEIGHTS = {"contacts": 1.0, "object": 1.0, "hand": 0.5, "base": -0.6, "sideways": 0.4, "height": -0.25}
BEHIND_GLASS = 0.4  # worth of what is seen through the environment, against what is seen freely
PREFERRED_ELEVATION = 32.0  # [deg] where both the top and the side of a flat object show


@cached_per_instance
def choose_camera(scene: VisualScene, *, aspect: float) -> Camera:
    """Return the best of 36 views: contacts and object in free sight, much of the hand, the motion across the picture.

    aspect: width of the picture over its height. Chosen once for each scene and aspect.
    """
    # Base and arm may leave the picture: they are large, and nothing happens there.
    framed = [scene.vertices("object", "link", "fingertip"), scene.arrow().mesh.vertices.reshape(-1, 3), scene.contacts]
    first_azimuth = np.arctan2(scene.motion[1], scene.motion[0]) + np.pi / AZIMUTHS
    directions = [
        (first_azimuth + turn * 2 * np.pi / AZIMUTHS, np.radians(elevation))
        for elevation in ELEVATIONS
        for turn in range(AZIMUTHS)
    ]
    points = np.concatenate(framed)
    tangent = TAN_HALF_HEIGHT / (FARTHER if scene.with_role("arm") else 1.0)
    cameras = [
        framing_camera(points, azimuth=azimuth, elevation=elevation, aspect=aspect, tangent=tangent)
        for azimuth, elevation in directions
    ]
    scores = _scores(scene, cameras, aspect)
    scores += WEIGHTS["height"] * np.repeat(np.abs(np.array(ELEVATIONS) / PREFERRED_ELEVATION - 1), AZIMUTHS)
    return cameras[int(scores.argmax())]


def _scores(scene: VisualScene, cameras: list[Camera], aspect: float) -> Float[np.ndarray, " camera"]:
    """Return how well each camera sees what matters, by small pictures of all of them in one go."""
    solid, hand, base = scene.triangles("object"), scene.triangles("link", "fingertip"), scene.triangles("base", "arm")
    walls = scene.triangles("environment", "assumed")  # what was never seen is looked through
    everything, environment = warp_mesh(np.concatenate([solid, hand, base])), warp_mesh(walls) if len(walls) else None
    positions = np.stack([camera.position for camera in cameras])
    rays = np.stack([camera.rays((round(COARSE_HEIGHT * aspect), COARSE_HEIGHT)) for camera in cameras])
    depth, face = first_hits(everything, positions[:, None], rays)
    alone = first_hits(warp_mesh(solid), positions[:, None], rays)[1] >= 0
    to_contacts = scene.contacts - positions[:, None]
    far = np.linalg.norm(to_contacts, axis=2)
    to_contacts /= far[:, :, None]
    contact_seen = first_hits(everything, positions[:, None], to_contacts)[0] > far - CONTACT_ROOM
    worth, contact_worth = np.ones(face.shape), np.ones(far.shape)
    if environment is not None:
        worth[first_hits(environment, positions[:, None], rays)[0] < depth] = BEHIND_GLASS
        hidden = first_hits(environment, positions[:, None], to_contacts)[0] < far - CONTACT_ROOM
        contact_worth[hidden] = BEHIND_GLASS
    of_object, of_base = (face >= 0) & (face < len(solid)), face >= len(solid) + len(hand)
    seen = {
        "contacts": (contact_seen * contact_worth).sum(axis=1) / max(1, len(scene.contacts)),
        "object": (worth * of_object).sum(axis=1) / np.maximum(1, alone.sum(axis=1)),
        "hand": (worth * ((face >= len(solid)) & ~of_base)).mean(axis=1),
        "base": of_base.mean(axis=1),
        "sideways": np.array([np.linalg.norm(np.cross(scene.motion, camera.forward)) for camera in cameras]),
    }
    return np.sum([WEIGHTS[name] * value for name, value in seen.items()], axis=0)


def hiding_faces(
    environment: trimesh.Trimesh, scene: VisualScene, camera: Camera, *, aspect: float
) -> Bool[np.ndarray, " face"]:
    """Return which triangles of `environment` (world frame) hide object or hand: whole flat faces, whole convex bodies."""
    rays = camera.rays((round(GLASS_HEIGHT * aspect), GLASS_HEIGHT))
    origins = np.broadcast_to(camera.position, rays.shape).copy()
    bodies = [scene.triangles("object"), scene.triangles("link", "fingertip")]
    goal, met = first_hits(warp_mesh(np.concatenate(bodies)), origins, rays)
    seen = met >= 0
    rays, origins, goal, of_object = rays[seen], origins[seen], goal[seen], met[seen] < len(bodies[0])
    needed = np.where(
        of_object, GLASS_SHARE["object"] * of_object.sum(), GLASS_SHARE["hand"] * (~of_object).sum()
    ).clip(min=2)

    flat = np.arange(len(environment.faces))
    for index, facet in enumerate(environment.facets):
        flat[facet] = len(environment.faces) + index
    hidden = np.zeros(flat.max(initial=0) + 1)
    walls = warp_mesh(environment.triangles)
    for _ in range(MAX_WALLS):
        depth, face = first_hits(walls, origins, rays)
        in_front = depth < goal
        if not in_front.any():
            break
        hidden += np.bincount(flat[face[in_front]], weights=1 / needed[in_front], minlength=len(hidden))
        step = depth[in_front] + 1e-4  # [m] the next ray starts just behind this wall
        rays, needed = rays[in_front], needed[in_front]
        origins, goal = origins[in_front] + rays * step[:, None], goal[in_front] - step
    hiding = hidden[flat] >= 1
    for body in trimesh.graph.connected_components(environment.face_adjacency, nodes=np.arange(len(flat)), min_len=2):
        if hiding[body].any() and environment.submesh([body], append=True).is_convex:
            hiding[body] = True
    return hiding
