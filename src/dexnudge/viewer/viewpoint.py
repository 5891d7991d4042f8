"""From where to look, and which walls to make of glass, so that object, hand and contacts are seen."""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float

from dexnudge.geometry.warp_runtime import wp
from dexnudge.viewer.camera import Camera, framing_camera
from dexnudge.viewer.ray_hits import first_hits, warp_mesh
from dexnudge.viewer.visual_scene import Part, VisualScene

AZIMUTHS = 12  # candidate directions around the object
ELEVATIONS = (20.0, 38.0, 58.0)  # [deg] above the horizon
COARSE_HEIGHT = 48  # pixels of the trial pictures
GLASS_HEIGHT = 120  # pixels of the picture that finds what stands in front
GLASS_SHARE = {"object": 0.01, "hand": 0.06}  # of its pixels: a wall that hides less of both stays solid
CONTACT_ROOM = 0.006  # [m] a contact lies between two surfaces; this much in front of it does not hide it
MAX_WALLS = 8  # surfaces of the environment that are looked through
WEIGHTS = {"contacts": 1.0, "object": 1.0, "hand": 0.5, "sideways": 0.4, "height": 0.25, "base": -0.6}
BEHIND_GLASS = 0.4  # worth of what is seen through the environment, against what is seen freely
PREFERRED_ELEVATION = 32.0  # [deg] where both the top and the side of a flat object show


@dataclass(frozen=True, eq=False)
class Trial:
    """Trees over the object alone, over object, hand and base in this order, and over the environment, if any."""

    object_alone: wp.Mesh
    subject: wp.Mesh
    object_faces: int
    hand_faces: int
    environment: wp.Mesh | None


def world_triangles(parts: tuple[Part, ...]) -> Float[np.ndarray, "face 3 3"]:
    """Corners of all triangles of some parts [m], world frame."""
    return np.concatenate([np.zeros((0, 3, 3)), *(part.vertices_in_world()[part.mesh.faces] for part in parts)])


def choose_camera(drawing: VisualScene, *, aspect: float) -> Camera:
    """The best of 36 directions: contacts and object in free sight, much of the hand, the motion across the picture."""
    triangles = world_triangles(drawing.with_role("object"))
    hand = world_triangles(drawing.with_role("link", "fingertip"))
    base = world_triangles(drawing.with_role("base"))
    walls = world_triangles(drawing.with_role("environment"))
    trial = Trial(
        warp_mesh(triangles),
        warp_mesh(np.concatenate([triangles, hand, base])),
        len(triangles),
        len(hand),
        warp_mesh(walls) if len(walls) else None,
    )
    # The base may leave the picture: it is large, and nothing happens there.
    framed = np.concatenate(
        [triangles.reshape(-1, 3), hand.reshape(-1, 3), drawing.arrow().mesh.vertices, drawing.contacts]
    )
    first_azimuth = np.arctan2(drawing.motion[1], drawing.motion[0]) + np.pi / AZIMUTHS
    best, best_score = None, -np.inf
    for elevation in ELEVATIONS:
        for azimuth in first_azimuth + np.arange(AZIMUTHS) * 2 * np.pi / AZIMUTHS:
            camera = framing_camera(framed, azimuth=azimuth, elevation=np.radians(elevation), aspect=aspect)
            score = _score(drawing, camera, trial, aspect)
            score -= WEIGHTS["height"] * abs(elevation - PREFERRED_ELEVATION) / PREFERRED_ELEVATION
            if score > best_score:
                best, best_score = camera, score
    assert best is not None
    return best


def _score(drawing: VisualScene, camera: Camera, trial: Trial, aspect: float) -> float:
    rays = camera.rays((round(COARSE_HEIGHT * aspect), COARSE_HEIGHT))
    eyes = np.broadcast_to(camera.position, rays.shape)
    depth, face = first_hits(trial.subject, eyes, rays)
    alone = first_hits(trial.object_alone, eyes, rays)[1] >= 0
    worth = np.full(len(rays), 1.0)
    if trial.environment is not None:
        worth[first_hits(trial.environment, eyes, rays)[0] < depth] = BEHIND_GLASS
    object_seen = (worth * ((face >= 0) & (face < trial.object_faces))).sum() / max(1, alone.sum())
    of_hand = (face >= trial.object_faces) & (face < trial.object_faces + trial.hand_faces)
    hand_seen = (worth * of_hand).mean()
    contacts_seen = 0.0
    if len(drawing.contacts):
        lines = drawing.contacts - camera.position
        far = np.linalg.norm(lines, axis=1)
        lines /= far[:, None]
        eyes = np.broadcast_to(camera.position, lines.shape)
        free = first_hits(trial.subject, eyes, lines)[0] > far - CONTACT_ROOM
        clear = np.ones(len(far))
        if trial.environment is not None:
            clear[first_hits(trial.environment, eyes, lines)[0] < far - CONTACT_ROOM] = BEHIND_GLASS
        contacts_seen = float((free * clear).mean())
    sideways = float(np.linalg.norm(np.cross(drawing.motion, camera.forward)))
    base_seen = float((face >= trial.object_faces + trial.hand_faces).mean())
    seen = {
        "contacts": contacts_seen,
        "object": object_seen,
        "hand": hand_seen,
        "base": base_seen,
        "sideways": sideways,
    }
    return float(sum(WEIGHTS[name] * value for name, value in seen.items()))


def hiding_faces(
    environment: trimesh.Trimesh, drawing: VisualScene, camera: Camera, *, aspect: float
) -> Bool[np.ndarray, " face"]:
    """Which triangles of `environment` (world frame) hide object or hand: whole flat faces, and whole convex bodies."""
    rays = camera.rays((round(GLASS_HEIGHT * aspect), GLASS_HEIGHT))
    origins = np.broadcast_to(camera.position, rays.shape).copy()
    bodies = [world_triangles(drawing.with_role(*roles)) for roles in (("object",), ("link", "fingertip"))]
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
        origins, goal, needed = (
            origins[in_front] + rays[in_front] * step[:, None],
            goal[in_front] - step,
            needed[in_front],
        )
        rays = rays[in_front]
    hiding = hidden[flat] >= 1
    for body in trimesh.graph.connected_components(environment.face_adjacency, nodes=np.arange(len(flat)), min_len=2):
        if hiding[body].any() and environment.submesh([body], append=True).is_convex:
            hiding[body] = True
    return hiding
