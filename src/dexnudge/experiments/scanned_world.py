"""What a scanner or a depth camera would give of a known scene: the surroundings, where the object is, the motion.

The true world may be tilted against gravity while the motion is given as if it were level; surfaces are triangles of a
scanner's size that scatter; the object's pose is off. Every error is drawn from one seed in one order, so that worlds of
several sizes of one error differ by nothing else.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float, Int
from trimesh.transformations import rotation_matrix

from dexnudge.experiments.config import ScanErrors
from dexnudge.perception.depth_view import DepthView
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.depth_camera import depth_views

LEVEL_AXIS = 0.5  # z of an axis below which a turn about it is a tip


@dataclass(frozen=True, eq=False)
class ScannedWorld:
    """A true world, and what is given of it.

    truth: of name and parameters of the scene that it was made from. surroundings: the scan, None where there are `views`.
    object_pose: T_world_object as given. motion: as given, unit, world.
    """

    truth: Scene
    surroundings: trimesh.Trimesh | None
    views: Sequence[DepthView]
    object_pose: Float[np.ndarray, "4 4"]
    motion: Float[np.ndarray, "3"]

    def understood(self) -> Scene:
        """Return the scene as it is understood from what is given, with the true object mesh and physics.

        Raises:
            SceneError: what is given is refused.
        """
        truth = self.truth
        physics = {name: getattr(truth, name) for name in ("motion_length", "mass", "max_normal_force")}
        physics |= {"friction_hand": truth.friction_hand, "friction_environment": truth.friction_environment}
        given: dict[str, Any] = {"object_pose": self.object_pose, "motion": self.motion, **physics}
        if truth.turn is not None and abs(truth.turn.axis[2]) < LEVEL_AXIS:
            given |= {"tip_deg": float(np.degrees(truth.turn.angle))}
        elif truth.turn is not None:
            degrees = float(np.degrees(truth.turn.angle) * np.sign(truth.turn.axis[2]))
            given |= {"turn_deg": degrees, "about": truth.turn.point}
        if self.surroundings is None:
            return Scene.from_depth(self.views, object=truth.object_mesh, **given)
        return Scene.from_files(truth.object_mesh, environment=self.surroundings, **given)


def scanned_world(scene: Scene, errors: ScanErrors, *, seed: int) -> ScannedWorld:
    """Return the true world made from a scene, and what a scanner with these errors would give of it."""
    tilts, poses, surfaces = (np.random.default_rng([seed, index]) for index in range(3))
    truth = tilted(scene, errors.tilt_deg, tilts)
    pose = disturbed_pose(truth, errors, poses)
    if errors.depth_views:
        return ScannedWorld(truth, None, depth_views(truth, surfaces, num=errors.depth_views), pose, scene.motion)
    return ScannedWorld(truth, scanned_mesh(truth.environment_mesh, errors, surfaces), (), pose, scene.motion)


def tilted(scene: Scene, degrees: float, generator: np.random.Generator) -> Scene:
    """Return the world turned about a random horizontal axis through the object's centre: all but gravity turns with it."""
    azimuth = generator.uniform(-np.pi, np.pi)
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    if degrees == 0:
        return scene
    turn = rotation_matrix(np.radians(degrees), axis, scene.object_in_world().center_mass)
    environment = scene.environment_mesh.copy()
    environment.apply_transform(turn)
    return replace(
        scene,
        environment_mesh=environment,
        T_world_object=turn @ scene.T_world_object,
        motion=turn[:3, :3] @ scene.motion,
        turn=scene.turn.moved(turn) if scene.turn else None,
    )


def disturbed_pose(scene: Scene, errors: ScanErrors, generator: np.random.Generator) -> Float[np.ndarray, "4 4"]:
    """Return T_world_object moved in a random direction and turned about a random axis through the object's centre."""
    direction, axis = (each / np.linalg.norm(each) for each in generator.standard_normal((2, 3)))
    if errors.pose_mm == errors.pose_deg == 0:
        return scene.T_world_object
    turn = rotation_matrix(np.radians(errors.pose_deg), axis, scene.object_in_world().center_mass)
    turn[:3, 3] += 1e-3 * errors.pose_mm * direction
    return turn @ scene.T_world_object


def scanned_mesh(mesh: trimesh.Trimesh, errors: ScanErrors, generator: np.random.Generator) -> trimesh.Trimesh:
    """Return surroundings as triangles of a scanner's size whose vertices scatter along their normals, and are rounded."""
    fine = remeshed(mesh, 1e-3 * errors.triangle_mm) if errors.triangle_mm else mesh.copy()
    vertices = np.array(fine.vertices)
    if errors.noise_mm:
        scatter = generator.standard_normal(len(vertices))
        vertices += 1e-3 * errors.noise_mm * scatter[:, None] * np.asarray(fine.vertex_normals)
    if errors.rounding_mm:
        step = 1e-3 * errors.rounding_mm
        vertices = np.rint(vertices / step) * step
    return trimesh.Trimesh(vertices, fine.faces, process=False)


SLACK = 1.6  # the longest edge over the spacing: halved edges are then about as long as the spacing


def remeshed(mesh: trimesh.Trimesh, spacing: float) -> trimesh.Trimesh:
    """Return the same surface in triangles whose edges are at most 1.6 `spacing` [m]; its edges and bodies stay.

    Too long edges are halved for both of their triangles, of each triangle the longest one first (M.-C. Rivara, *Algorithms
    for refining triangular grids suitable for adaptive and multigrid techniques*, 1984): angles stay fair, and no gaps open.
    """
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    while True:
        sides = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
        keys, edge = np.unique(sides[:, 0] * len(vertices) + sides[:, 1], return_inverse=True)
        edges, edge = np.stack(np.divmod(keys, len(vertices)), axis=1), edge.reshape(-1, 3)
        length = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
        # Each face begins with its longest side; of equally long ones with that which its neighbour takes, too.
        first = np.lexsort((edge, length[edge]), axis=1)[:, -1]
        turn = (first[:, None] + np.arange(3)) % 3
        faces, edge = np.take_along_axis(faces, turn, axis=1), np.take_along_axis(edge, turn, axis=1)
        halved = length[edge[:, 0]] > SLACK * spacing
        if not halved.any():
            return trimesh.Trimesh(vertices, faces, process=False)
        marked = np.zeros(len(edges), dtype=bool)
        while halved.any():  # the longest of a face that has another one halved, too
            marked[edge[halved, 0]] = True
            halved = marked[edge].any(axis=1) & ~marked[edge[:, 0]]
        middle = np.full(len(edges), -1)
        middle[marked] = len(vertices) + np.arange(marked.sum())
        vertices = np.concatenate([vertices, vertices[edges[marked]].mean(axis=1)])
        faces = _halved(faces, middle[edge])


def _halved(faces: Int[np.ndarray, "face 3"], middle: Int[np.ndarray, "face 3"]) -> Int[np.ndarray, "n 3"]:
    """Return the triangles that faces fall into; `middle` is the new vertex on each side k -> k + 1, -1 for none.

    Side 0 is cut first, from its middle to the corner across; then each half at its own outer side.
    """
    whole = middle[:, 0] < 0
    a, b, c = faces[~whole].T
    d, e, f = middle[~whole].T
    parts = [faces[whole]]
    for corners, new in (((d, c, a), f), ((d, b, c), e)):  # in each half, the outer side is that from corner 1 to 2
        half, cut = np.stack(corners, axis=1), new >= 0
        (one, two, three), between = half[cut].T, new[cut]
        parts += [half[~cut], np.stack([one, two, between], axis=1), np.stack([one, between, three], axis=1)]
    return np.concatenate(parts)
