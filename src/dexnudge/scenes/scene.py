"""The problem to be solved: an object, its surroundings, and the motion that it should make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import SceneError
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_lattice import Boxes, lattice_in_boxes

SPACING = 0.003  # [m] between the points that are tested
MARGIN = 1e-6  # [m] around the bounds, so that rounding drops no point on them


def deepest_overlap(first: trimesh.Trimesh, second: trimesh.Trimesh) -> tuple[float, Float[np.ndarray, "3"]]:
    """Largest depth [m] of a point of one mesh inside the other, and that point; 0 and a point where they are apart.

    Both ways: evenly spread points of each mesh, its corners and edges among them, against the other's exact distance.
    """
    depth, where = 0.0, np.asarray(first.vertices[0], dtype=np.float64)
    for points_of, inside_of in ((first, second), (second, first)):
        points = _points_near(points_of, inside_of.bounds)
        if len(points) == 0:
            continue
        distance = ExactDistance(inside_of)(points).distance
        deepest = int(np.argmin(distance))
        if -distance[deepest] > depth:
            depth, where = float(-distance[deepest]), points[deepest]
    return depth, where


def _points_near(mesh: trimesh.Trimesh, bounds: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "n 3"]:
    """Points of the mesh within the bounds, corners and edges among them."""
    centre, half = bounds.mean(axis=0), np.ptp(bounds, axis=0) / 2 + MARGIN
    box = Boxes(centre=centre[None], axes=np.eye(3)[None], half=half[None])
    return lattice_in_boxes(np.asarray(mesh.triangles), box, spacing=SPACING)[0]


FRICTION_HAND = 0.8  # rubber fingertip on plastic
FRICTION_ENVIRONMENT = 0.4  # plastic on painted wood
MASS = 0.15  # [kg] a phone or a remote
MAX_NORMAL_FORCE = 5.0  # [N] per digit link; what a tendon-driven finger holds continuously
MOTION_LENGTH = 0.10  # [m]
INITIAL_PENETRATION_LIMIT = 1e-3  # [m] the limit that a configuration must keep, applied to the scene itself
RIGID_TOLERANCE = 1e-5  # on R^T R - I; poses typed by hand carry six digits


@dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """An object at rest in its surroundings and the motion that it should make.

    Attributes:
        object_mesh: metres, object frame.
        environment_mesh: metres, world frame (z up, gravity along -z).
        T_world_object: (4, 4) rigid transform from the object frame to the world.
        motion: (3,) unit vector in the world, direction in which the object should slide.
        motion_length: how far it should slide [m].
        mass: of the object [kg].
        friction_hand: Coulomb coefficient between hand and object.
        friction_environment: Coulomb coefficient between object and surroundings.
        max_normal_force: largest normal force of one digit link [N].
        name: scene family, or "user".
        parameters: what the family drew, by name, lengths in metres unless the name says otherwise.
        seed: seed of the generator that drew the parameters, None when nothing was drawn.

    Raises:
        SceneError: on construction, when a number is out of its domain, the pose is not rigid, the motion is
            zero, or a mesh is empty. A motion that is not of unit length is normalised.
    """

    object_mesh: trimesh.Trimesh
    environment_mesh: trimesh.Trimesh
    T_world_object: Float[np.ndarray, "4 4"]
    motion: Float[np.ndarray, "3"]
    motion_length: float = MOTION_LENGTH
    mass: float = MASS
    friction_hand: float = FRICTION_HAND
    friction_environment: float = FRICTION_ENVIRONMENT
    max_normal_force: float = MAX_NORMAL_FORCE
    name: str = "user"
    parameters: dict[str, Any] = field(default_factory=dict)
    seed: int | None = None

    def __post_init__(self) -> None:
        for label, mesh in (("object", self.object_mesh), ("environment", self.environment_mesh)):
            if len(mesh.faces) == 0:
                raise SceneError(f"the {label} mesh of the scene is empty; expected at least one triangle")
        object.__setattr__(self, "T_world_object", rigid_transform(self.T_world_object))
        object.__setattr__(self, "motion", unit_motion(self.motion))
        for label in ("motion_length", "mass", "max_normal_force"):
            _check_number(label, getattr(self, label), minimum_excluded=True)
        for label in ("friction_hand", "friction_environment"):
            _check_number(label, getattr(self, label), minimum_excluded=False)

    def object_in_world(self) -> trimesh.Trimesh:
        """Copy of the object's mesh in the world frame, metres."""
        mesh = self.object_mesh.copy()
        mesh.apply_transform(self.T_world_object)
        return mesh

    def save(self, folder: str | Path) -> Path:
        """Write scene.json, object.obj and environment.obj into a folder; see `files.save_scene`."""
        from dexnudge.scenes.files import save_scene

        return save_scene(self, folder)

    @classmethod
    def load(cls, folder: str | Path) -> Scene:
        """Read a folder that `save` wrote; see `files.load_scene`."""
        from dexnudge.scenes.files import load_scene

        return load_scene(folder)

    @classmethod
    def from_files(
        cls,
        object: str | Path | trimesh.Trimesh,  # noqa: A002 - the public name
        *,
        environment: str | Path | trimesh.Trimesh,
        object_pose: str | Path | Float[np.ndarray, "4 4"],
        motion: Sequence[float] | Sequence[int] | Float[np.ndarray, "3"],
        units: str = "m",
        length: float | None = None,
        **physics: Any,
    ) -> Scene:
        """Return the scene of an object in your own surroundings, checked.

        Args:
            object: mesh file in `units`, name of a built-in object, or a mesh in metres; object frame.
            environment: mesh file in `units`, or a mesh in metres; world frame, z up.
            object_pose: T_world_object, or a JSON file with it; metres, whatever `units` says.
            motion: direction (3,) in the world that the object should slide in; normalised.
            units: of the numbers in the mesh files: m, cm, mm or in.
            length: scale the object so that its longest side has this length [m].
            physics: motion_length [m], mass [kg], friction_hand, friction_environment, max_normal_force [N]; defaults
                as above.

        Raises:
            SceneError: a malformed pose, a zero motion, a number out of its domain, or an environment that already
                penetrates the object by more than 1 mm.
            MeshError: a mesh cannot be used.
            UnknownNameError: the object is neither a file nor a built-in one.
        """
        from dexnudge.objects.sets import object_mesh
        from dexnudge.scenes.user import user_scene

        mesh = object_mesh(object, units=units, length=length)
        return user_scene(mesh, environment=environment, object_pose=object_pose, motion=motion, units=units, **physics)

    def __repr__(self) -> str:
        size = " x ".join(f"{1e3 * side:.0f}" for side in self.object_mesh.extents)
        motion = ", ".join(f"{each:.2f}" for each in self.motion)
        return (
            f"Scene '{self.name}': object {size} mm, {1e3 * self.mass:.0f} g, to slide {1e3 * self.motion_length:.0f} mm "
            f"along ({motion}); friction {self.friction_hand:g} at the hand, {self.friction_environment:g} at the "
            f"surroundings ({len(self.environment_mesh.faces)} triangles)"
        )

    def validate(self) -> None:
        """Refuse a scene whose surroundings already penetrate the object by more than 1 mm.

        Both ways: points of the object inside the environment and points of the environment inside the object.

        Raises:
            SceneError: naming the depth and where it is.
        """
        depth, point = deepest_overlap(self.object_in_world(), self.environment_mesh)
        if depth > INITIAL_PENETRATION_LIMIT:
            raise SceneError(
                f"the environment already penetrates the object by {1e3 * depth:.1f} mm near "
                f"({point[0]:.3f}, {point[1]:.3f}, {point[2]:.3f}); expected at most "
                f"{1e3 * INITIAL_PENETRATION_LIMIT:.0f} mm; move the object out along the surface that it rests on, "
                "or check that both meshes are in metres"
            )


def rigid_transform(value: Any) -> Float[np.ndarray, "4 4"]:
    """`value` as a float64 rigid transform; SceneError when it is not one."""
    try:
        pose = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise SceneError(f"T_world_object is not a matrix of numbers; expected 4 x 4 ({error})") from error
    if pose.shape != (4, 4):
        raise SceneError(f"T_world_object has shape {pose.shape}; expected (4, 4)")
    if not np.isfinite(pose).all():
        raise SceneError("T_world_object holds NaN or infinity; expected finite numbers")
    rotation = pose[:3, :3]
    skew = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if skew > RIGID_TOLERANCE or np.linalg.det(rotation) < 0 or np.abs(pose[3] - [0, 0, 0, 1]).max() > 0:
        raise SceneError(
            f"T_world_object is not a rigid transform: |R^T R - I| = {skew:.2g}, det R = {np.linalg.det(rotation):.3g}, "
            f"last row {pose[3].tolist()}; expected a rotation (tolerance {RIGID_TOLERANCE:g}, det 1) and last row "
            "[0, 0, 0, 1]; scale the mesh, not the pose"
        )
    return pose


def unit_motion(value: Any) -> Float[np.ndarray, "3"]:
    """`value` as a unit vector; SceneError when it is zero, not finite, or not three numbers."""
    try:
        motion = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise SceneError(f"motion is not a vector of numbers; expected three ({error})") from error
    if motion.shape != (3,):
        raise SceneError(f"motion has shape {motion.shape}; expected three numbers (dx, dy, dz)")
    length = float(np.linalg.norm(motion))
    if not np.isfinite(length) or length < 1e-9:
        raise SceneError(
            f"motion is ({motion[0]:g}, {motion[1]:g}, {motion[2]:g}); expected a finite direction that is not zero, "
            "such as (1, 0, 0)"
        )
    return motion / length


def _check_number(label: str, value: object, *, minimum_excluded: bool) -> None:
    number = float(value) if isinstance(value, Real) else np.nan
    if not np.isfinite(number) or number < 0 or (minimum_excluded and number == 0):
        raise SceneError(f"{label} is {value!r}; expected a finite number {'> 0' if minimum_excluded else '>= 0'}")
