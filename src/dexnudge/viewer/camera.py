"""A pinhole camera: where it stands so that object, hand and contacts are seen, and what becomes glass for it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from dexnudge.geometry.exact_distance import Rays
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.boxes import joined
from dexnudge.viewer.visual_scene import ROBOT, SEE_THROUGH, Part, VisualScene

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


AZIMUTHS = 16  # candidate directions around what is seen
ELEVATIONS = (18.0, 32.0, 46.0, 62.0)  # [deg] above the horizon
SURFACE_POINTS = 400  # on object, hand and base each, by which it is found how much of them is seen
GLASS_POINTS = 3000  # on object and hand each, by which it is found what stands in front
GLASS_SHARE = {"object": 0.005, "hand": 0.03}  # of them: a wall that hides less of both stays solid
ON_SURFACE = 0.0005  # [m] a point this much behind what a ray meets is what it meets
CONTACT_ROOM = 0.006  # [m] a contact lies between two surfaces; this much in front of it does not hide it
MAX_WALLS = 8  # surfaces that are looked through, one behind the other
FAR = 100.0  # [m] beyond every scene
WEIGHTS = {"object": 4.0, "contacts": 1.0, "hand": 0.2, "area": 0.6, "ghost": 3.0, "base": -0.3, "sideways": 0.4}
WEIGHTS["height"] = -0.25
BEHIND_GLASS = 0.5  # worth of what is seen through surroundings or base, against what is seen freely
PREFERRED_ELEVATION = 32.0  # [deg] where both the top and the side of a flat object show


@cached_per_instance
def choose_camera(scene: VisualScene, *, aspect: float) -> Camera:
    """Return the best view of one scene, from as near as shows object, hand and motion; see `best_camera`.

    Base and arm may leave the picture: they are large, and nothing happens there. aspect: width over height.
    """
    shown = scene.vertices("object", "link", "fingertip", "ghost", "arrow")
    framed = np.concatenate([shown, scene.arrow().mesh.vertices.reshape(-1, 3), scene.contacts])
    return best_camera([scene], framed, aspect=aspect)


def best_camera(scenes: Sequence[VisualScene], framed: Float[np.ndarray, "n 3"], *, aspect: float) -> Camera:
    """Return the best of 64 views: much of the object, the contacts and the hand in sight, the motion across the picture.

    Args:
        scenes: moments that one camera shows, at least one.
        framed: points that must be in the picture [m].
        aspect: width of the picture over its height.
    """
    motion = scenes[0].motion
    turns = np.arctan2(motion[1], motion[0]) + (np.arange(AZIMUTHS) + 0.5) * 2 * np.pi / AZIMUTHS
    places = [(azimuth, np.radians(elevation)) for elevation in ELEVATIONS for azimuth in turns]
    cameras = [framing_camera(framed, azimuth=each, elevation=rise, aspect=aspect) for each, rise in places]
    scores = np.sum([_scores(scene, cameras) for scene in scenes], axis=0) / len(scenes)
    scores += WEIGHTS["height"] * np.repeat(np.abs(np.array(ELEVATIONS) / PREFERRED_ELEVATION - 1), AZIMUTHS)
    return cameras[int(scores.argmax())]


def _scores(scene: VisualScene, cameras: Sequence[Camera]) -> Float[np.ndarray, " camera"]:
    """Return how well each camera sees what matters."""
    body, hand, base = scene.mesh("object"), scene.mesh("link", "fingertip"), scene.mesh(*ROBOT)
    ghosts = scene.mesh("ghost")
    # What hides, with how much what lies behind it is worth; what was never seen is looked through.
    walls = scene.mesh("environment", "assumed")
    blockers = (joined([body, hand]), 0.0), (walls, BEHIND_GLASS), (base, BEHIND_GLASS)
    rays = [(Rays(mesh), value) for mesh, value in blockers if len(mesh.faces)]
    positions = np.stack([camera.position for camera in cameras])

    def worth(points: Float[np.ndarray, "n 3"], room: float) -> Float[np.ndarray, "camera n"]:
        hidden = [np.where(_hidden(each, positions, points, room), value, 1.0) for each, value in rays]
        return np.prod(hidden, axis=0)

    scores = np.array([np.linalg.norm(np.cross(scene.motion, camera.forward)) for camera in cameras])
    scores *= WEIGHTS["sideways"]
    if len(scene.contacts):
        scores += WEIGHTS["contacts"] * worth(scene.contacts, CONTACT_ROOM).mean(axis=1)
    for name, mesh in (("object", body), ("hand", hand)):
        if len(mesh.faces):
            points, facing = _surface(mesh, positions, SURFACE_POINTS)
            seen = (facing * worth(points, ON_SURFACE)).sum(axis=1)
            alone = (facing * ~_hidden(Rays(mesh), positions, points, ON_SURFACE)).sum(axis=1)
            # Of what could be seen from there, and of the most that could be seen: a flat object shows little from aside.
            scores += WEIGHTS[name] * seen / alone + WEIGHTS["area"] * seen / alone.max()
    if len(ghosts.faces):  # where an object that turns comes
        points, facing = _surface(ghosts, positions, SURFACE_POINTS)
        facing = facing * ~_hidden(Rays(ghosts), positions, points, ON_SURFACE)
        scores += WEIGHTS["ghost"] * (facing * worth(points, ON_SURFACE)).sum(axis=1) / facing.sum(axis=1).max()
    if len(base.faces):
        points, _ = _surface(base, positions, SURFACE_POINTS)
        middle = scene.middle()
        scores += WEIGHTS["base"] * np.array([_in_front(camera, points, middle) for camera in cameras])
    return scores


def _surface(
    mesh: trimesh.Trimesh, positions: Float[np.ndarray, "camera 3"], count: int
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "camera n"]]:
    """Return points spread evenly on a mesh, and how much of it each stands for as seen from each place: a cosine, or 0."""
    points, face = trimesh.sample.sample_surface(mesh, count, seed=0)
    towards = positions[:, None] - points
    towards /= np.linalg.norm(towards, axis=2, keepdims=True)
    return np.asarray(points), np.einsum("cni,ni->cn", towards, mesh.face_normals[face]).clip(min=0.0)


def _hidden(
    rays: Rays, positions: Float[np.ndarray, "camera 3"], points: Float[np.ndarray, "n 3"], room: float
) -> Bool[np.ndarray, "camera n"]:
    """Return whether something stands more than `room` [m] in front of points, seen from each place."""
    lines = points - positions[:, None]
    far = np.linalg.norm(lines, axis=2)
    starts = np.broadcast_to(positions[:, None], lines.shape).reshape(-1, 3)
    met = rays.first_hits(starts, (lines / far[:, :, None]).reshape(-1, 3), reach=FAR)[0]
    return met.reshape(far.shape) < far - room


def _in_front(camera: Camera, points: Float[np.ndarray, "n 3"], middle: Float[np.ndarray, "3"]) -> float:
    """Return the share of points that lie in the picture, before its middle."""
    lines = points - camera.position
    depth = lines @ camera.forward
    inside = (np.abs(lines @ camera.right) < camera.tan_width * depth) & (
        np.abs(lines @ camera.up) < camera.tan_height * depth
    )
    return float((inside & (depth < (middle - camera.position) @ camera.forward)).mean())


def hiding_faces(scene: VisualScene, camera: Camera) -> list[Bool[np.ndarray, "_"]]:
    """Return which triangles hide object or hand, of each part that may be looked through, in the order of `scene.parts`.

    Of surroundings whole flat faces and whole convex bodies; base and links of an arm as a whole.
    """
    bodies = {"object": scene.mesh("object"), "hand": scene.mesh("link", "fingertip")}
    own, place = Rays(joined(list(bodies.values()))), camera.position[None]
    goals, needed = [], []
    for name, mesh in bodies.items():
        if len(mesh.faces):
            points, facing = _surface(mesh, place, GLASS_POINTS)
            seen = points[(facing[0] > 0) & ~_hidden(own, place, points, ON_SURFACE)[0]]
            goals.append(seen)
            needed.append(np.full(len(seen), max(2.0, GLASS_SHARE[name] * len(seen))))
    lines = np.concatenate(goals) - camera.position
    far = np.linalg.norm(lines, axis=1) - ON_SURFACE
    return [
        _hiding(
            part, camera.position, lines / np.linalg.norm(lines, axis=1, keepdims=True), far, np.concatenate(needed)
        )
        for part in scene.with_role(*SEE_THROUGH)
    ]


def _hiding(
    part: Part,
    origin: Float[np.ndarray, "3"],
    rays: Float[np.ndarray, "n 3"],
    goal: Float[np.ndarray, " n"],
    needed: Float[np.ndarray, " n"],
) -> Bool[np.ndarray, " face"]:
    """Return which triangles of a part hide enough of what lies `goal` [m] away along rays: as many rays as `needed`."""
    flat, body = _patches(part.mesh)
    if part.role in ROBOT:
        flat = body = np.zeros_like(flat)
    hidden, caster = np.zeros(flat.max(initial=0) + 1), _rays(part)
    origins = np.tile(origin, (len(rays), 1))
    for _ in range(MAX_WALLS):
        depth, face = caster.first_hits(origins, rays, reach=FAR)
        in_front = depth < goal
        if not in_front.any():
            break
        hidden += np.bincount(flat[face[in_front]], weights=1 / needed[in_front], minlength=len(hidden))
        step = depth[in_front] + 1e-4  # [m] the next ray starts just behind this wall
        rays, needed = rays[in_front], needed[in_front]
        origins, goal = origins[in_front] + rays * step[:, None], goal[in_front] - step
    hiding = hidden[flat] >= 1
    return hiding | (np.isin(body, body[hiding]) & (body >= 0))


@cached_per_instance
def _rays(part: Part) -> Rays:
    return Rays(part.mesh_in_world())


@cached_per_instance
def _patches(mesh: trimesh.Trimesh) -> tuple[Int[np.ndarray, " face"], Int[np.ndarray, " face"]]:
    """Return of each triangle the flat face that it belongs to, and the convex body, -1 for none."""
    flat, body = np.arange(len(mesh.faces)), np.full(len(mesh.faces), -1)
    for index, facet in enumerate(mesh.facets):
        flat[facet] = len(mesh.faces) + index
    pieces = trimesh.graph.connected_components(mesh.face_adjacency, nodes=np.arange(len(flat)), min_len=2)
    for index, piece in enumerate(pieces):
        if mesh.submesh([piece], append=True).is_convex:
            body[piece] = index
    return flat, body
