"""The problem to be solved: an object, its surroundings, and the motion that it should make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import SceneError, check_kind, check_path, quote
from dexnudge.finding import Finding
from dexnudge.geometry.coarsening import coarsened_far
from dexnudge.geometry.mesh_repair import turned_toward
from dexnudge.geometry.meshes import centre_of_mass, checked_environment, load_environment
from dexnudge.geometry.rigid import rigid_transform
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.objects.sets import object_mesh
from dexnudge.perception.depth_view import DepthView
from dexnudge.scenes.files import LARGEST_NUMBER, MARGINS, NUMBERS, load_pose, read_scene, write_scene
from dexnudge.scenes.motion import FARTHEST_AXIS, SMALLEST_TURN, Motion, Turn, unit_motion
from dexnudge.scenes.own_surroundings import check_margins, understood, without_hole_below
from dexnudge.scenes.placement import placement_findings, size_findings
from dexnudge.scenes.resting import long_side_along_x
from dexnudge.scenes.supports import TOUCHING, Support, all_supports
from dexnudge.scenes.uncertainty import Uncertainty

FRICTION_HAND = 0.8  # rubber fingertip on plastic
FRICTION_ENVIRONMENT = 0.4  # plastic on painted wood
MASS = 0.15  # [kg] a phone or a remote
MAX_NORMAL_FORCE = 5.0  # [N] per digit link; what a tendon-driven finger holds continuously
MOTION_LENGTH = 0.10  # [m]
SAME_PLACE = 1e-6  # [m] and entries of a pose: what writing to files changes
POSITIVE = ("mass", "max_normal_force")  # numbers that are never 0
ABOVE_MIDDLE = 0.75  # of an object's height
TURN_PLACES = 19  # between which a turn's bounds are taken: 10 degrees apart for the largest one
SHORTEST_MOTION = 1e-3  # [m] a shorter one is lost in the tolerances
LONGEST_MOTION = 2.0  # [m] farther than an arm reaches; a greater number is in another unit


@dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """An object at rest in its surroundings and the motion that it should make.

    Attributes:
        object_mesh: metres, object frame.
        environment_mesh: metres, world frame (z up, gravity along -z).
        T_world_object: (4, 4) rigid transform from the object frame to the world.
        motion: (3,) unit vector in the world, direction in which the object should slide; with a turn alone, a heading.
        motion_length: how far it should slide [m]; 0.10 unless given; may be 0 with a turn.
        turn: what the object does before it slides; None where it only slides.
        mass: mass of the object [kg]; 0.15 unless given.
        friction_hand: Coulomb coefficient between hand and object; 0.8 unless given.
        friction_environment: Coulomb coefficient between object and surroundings; 0.4 unless given.
        max_normal_force: largest normal force of one digit link [N]; 5 unless given.
        surface_noise: by how much the measured surfaces scatter about the true ones, root mean square [m]; 0 for a model.
        clearance: distance that hands keep from the surroundings [m]; at least the noise.
        uncertainty: the worlds by whose share configurations are ranked; None where the numbers above are certain.
        name: scene family, or "user".
        parameters: what the family drew, by name, lengths in metres unless the name says otherwise.
        seed: seed of the generator that drew the parameters, None when nothing was drawn.

    Raises:
        SceneError: on construction, when a number is out of its domain, the pose is not rigid, the motion is
            zero, the axis of the turn is away from the object, or a mesh is empty. A motion that is not of unit length is
            normalised.
    """

    object_mesh: trimesh.Trimesh
    environment_mesh: trimesh.Trimesh
    T_world_object: Float[np.ndarray, "4 4"]
    motion: Float[np.ndarray, "3"]
    motion_length: float = MOTION_LENGTH
    turn: Turn | None = None
    mass: float = MASS
    friction_hand: float = FRICTION_HAND
    friction_environment: float = FRICTION_ENVIRONMENT
    max_normal_force: float = MAX_NORMAL_FORCE
    surface_noise: float = 0.0
    clearance: float = 0.0
    uncertainty: Uncertainty | None = None
    name: str = "user"
    parameters: dict[str, Any] = field(default_factory=dict)
    seed: int | None = None

    def __post_init__(self) -> None:
        for label, mesh in (("object", self.object_mesh), ("environment", self.environment_mesh)):
            check_kind(f"{label}_mesh", mesh, trimesh.Trimesh, 'load_mesh("phone.obj")')
            if len(mesh.faces) == 0:
                raise SceneError(f"the {label} mesh of the scene is empty; expected at least one triangle")
        object.__setattr__(self, "T_world_object", rigid_transform(self.T_world_object))
        object.__setattr__(self, "motion", unit_motion(self.motion))
        if self.turn is not None:
            check_kind("turn", self.turn, Turn, "dn.Turn(np.pi / 2, axis=(0, 0, 1), point=(0, 0, 0))")
        positive = POSITIVE if self.turn is not None else (*POSITIVE, "motion_length")
        for label in (*NUMBERS, *MARGINS):
            _check_number(label, getattr(self, label), minimum_excluded=label in positive)
        check_margins(surface_noise=self.surface_noise, clearance=self.clearance)
        object.__setattr__(self, "clearance", max(self.clearance, self.surface_noise))
        if self.turn is not None and (away := float(self.turn.distance(self._corners).min())) > FARTHEST_AXIS:
            raise SceneError(
                f"the axis of the turn is {away:.3g} m from the object; expected at most {FARTHEST_AXIS:g} m; give a point "
                "nearer to it, in metres, or slide it"
            )

    def lies_as(self, other: Scene) -> bool:
        """Return whether an object of as many vertices lies in the same place, and should go the same way, as in `other`."""
        mine, theirs = (
            (len(each.object_mesh.vertices), *each.T_world_object.ravel(), *each.motion) for each in (self, other)
        )
        return bool(np.allclose(mine, theirs, atol=SAME_PLACE))

    def object_in_world(self) -> trimesh.Trimesh:
        """Return a copy of the object's mesh in the world frame, metres."""
        return self.object_mesh.copy().apply_transform(self.T_world_object)

    @property
    @cached_per_instance
    def centre_of_mass(self) -> Float[np.ndarray, "3"]:
        """Of the object, world [m]."""
        return np.asarray(self.T_world_object[:3, :3] @ centre_of_mass(self.object_mesh) + self.T_world_object[:3, 3])

    @property
    def _corners(self) -> Float[np.ndarray, "8 3"]:
        """Of the object's bounding box, world [m]."""
        return np.asarray(
            trimesh.transform_points(trimesh.bounds.corners(self.object_mesh.bounds), self.T_world_object)
        )

    @property
    @cached_per_instance
    def object_motion(self) -> Motion:
        """The turn and the slide as one motion of the object."""
        points = trimesh.transform_points(self.object_mesh.vertices, self.T_world_object)
        radius = float(self.turn.distance(points).max()) if self.turn else 0.0
        return Motion(self.turn, self.motion, self.motion_length, radius)

    def carried(self, way: float) -> Scene:
        """Return the scene with the object where it is after `way` [m] of its motion; what is left of the turn stays to do.

        The slide keeps its length: a scene needs a motion to the end.
        """
        motion, turn = self.object_motion, self.turn
        if turn is not None:
            left = turn.angle - motion.angle(way)
            turn = replace(turn, angle=left) if left >= SMALLEST_TURN else None if motion.slide_length else turn
        return replace(self, T_world_object=motion.displacement(way) @ self.T_world_object, turn=turn)

    def way_bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the corners of the world's box that holds the object all along its motion [m]."""
        motion, here = self.object_motion, np.asarray(self.object_in_world().bounds)
        if self.turn is None:
            there = here + self.motion_length * self.motion
            return np.stack([np.minimum(here, there)[0], np.maximum(here, there)[1]])
        ways = [*np.linspace(0.0, motion.turn_length, TURN_PLACES), motion.length]
        corners = np.concatenate([trimesh.transform_points(self._corners, motion.displacement(way)) for way in ways])
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    @classmethod
    def from_files(
        cls,
        object: str | Path | trimesh.Trimesh,  # noqa: A002 - the public name
        *,
        environment: str | Path | trimesh.Trimesh,
        object_pose: str | Path | Float[np.ndarray, "4 4"],
        motion: Sequence[float] | Sequence[int] | Float[np.ndarray, "3"] | None = None,
        turn_deg: float | None = None,
        tip_deg: float | None = None,
        about: Sequence[float] | Float[np.ndarray, "3"] | None = None,
        units: str = "m",
        length: float | None = None,
        settle: str = "auto",
        surface_noise: float | None = None,
        clearance: float = 0.0,
        validate: bool = True,
        **physics: Any,
    ) -> Scene:
        """Return the scene of an object in your own surroundings, understood and checked.

        What carries or holds the object is found and counts as flat, the object comes to rest on it, and the motion is
        turned into its plane; `notes` and `parameters` say what was done. A clean world stays as it is.

        Args:
            object: mesh file in `units`, name of a built-in object, or a mesh in metres; object frame.
            environment: mesh file in `units`, or a mesh in metres; world frame, z up.
            object_pose: T_world_object, or a JSON file with it or with "position" and "quaternion_wxyz"; metres, whatever
                `units` says.
            motion: direction (3,) in the world that the object should slide in, or tip over; normalised. An object that only
                turns needs none.
            turn_deg: angle by which it should turn first, about the normal of what carries it, counter-clockwise from above
                where positive; from -180 to 180.
            tip_deg: angle by which it should tip first, over that edge of what carries it to which `motion` leads; the
                motion is turned to be straight across it.
            about: point (3,) of the turn's axis [m, world]; its centre of mass unless given, or where something blocks that
                the corner of the rectangle around it, seen from above, about which it turns farthest.
            units: unit of the numbers in the mesh files: m, cm, mm or in.
            length: scale the object so that its longest side has this length [m].
            settle: "auto" moves the object by up to 5 mm and 3 deg to rest on its supports; "off" keeps its pose.
            surface_noise: by which the surfaces scatter, root mean square [m]; measured at the supports if left out.
            clearance: that hands keep from the surroundings at least [m]; the noise where that is more.
            validate: refuse a misplaced object; False leaves it to `findings` to say what is wrong.
            physics: motion_length [m], mass [kg], friction_hand, friction_environment, max_normal_force [N]; defaults
                as above; with `turn_deg` or `tip_deg` the object does not slide unless `motion_length` is given.

        Raises:
            SceneError: a malformed pose, a zero motion, an invalid turn or one that contradicts another, a tip without
                a support, a number out of its domain, or surroundings that penetrate the object by more than 1 mm or do not
                touch it.
            MeshError: a mesh cannot be used.
            UnknownNameError: the object is neither a file nor a built-in one.
        """
        from dexnudge.scenes.asked_turn import check_heading, with_turn

        check_physics(physics)
        asked = check_heading(
            motion, turn_deg=turn_deg, tip_deg=tip_deg, about=about, slides=physics.get("motion_length")
        )
        slide = physics.pop("motion_length", 0.0) if asked else None
        mesh = object_mesh(object, units=units, length=length)
        if isinstance(environment, trimesh.Trimesh):
            environment = checked_environment(environment)
        else:
            environment = load_environment(environment, units=units)
        pose = load_pose(object_pose) if isinstance(object_pose, str | Path) else rigid_transform(object_pose)
        direction = _heading(mesh, pose) if motion is None else unit_motion(motion)
        bounds = cls(mesh, environment, pose, direction, **physics).way_bounds()
        if asked:  # about a point of the object or another one, it stays within this
            points = np.concatenate([bounds, [bounds[0] if about is None else about]])
            reach = float(np.linalg.norm(np.ptp(points, axis=0)))
            bounds = np.stack([points.min(axis=0) - reach, points.max(axis=0) + reach])
        environment = coarsened_far(environment, *bounds)
        environment = turned_toward(environment, _above_middle(mesh, pose))
        body = mesh.copy().apply_transform(pose)
        environment, around = without_hole_below(environment, body)
        fields = understood(
            mesh,
            environment,
            pose,
            direction,
            settle_object=settle,
            surface_noise=around if surface_noise is None else surface_noise,
            clearance=clearance,
        )
        scene = cls(**fields, **physics)
        if validate:
            scene.validate()
        return with_turn(scene, turn_deg=turn_deg, tip_deg=tip_deg, about=about, motion_length=slide)

    @classmethod
    def from_depth(
        cls,
        views: str | Path | Sequence[DepthView],
        *,
        object: str | Path | trimesh.Trimesh | None = None,  # noqa: A002 - the public name
        object_pose: str | Path | Float[np.ndarray, "4 4"] | None = None,
        motion: Sequence[float] | Sequence[int] | Float[np.ndarray, "3"] | None = None,
        turn_deg: float | None = None,
        tip_deg: float | None = None,
        about: Sequence[float] | Float[np.ndarray, "3"] | None = None,
        masks: str | None = None,
        view_points: Any = None,
        unseen: str = "solid",
        voxel: float | None = None,
        settle: str = "auto",
        surface_noise: float | None = None,
        clearance: float = 0.0,
        units: str = "m",
        length: float | None = None,
        validate: bool = True,
        **physics: Any,
    ) -> Scene:
        """Return the scene of an object whose surroundings a depth camera measured, understood and checked.

        The views are fused around the object and its way; planes are continued through holes and behind the object where
        what is around says so. Then the scene is understood as in `from_files`. Without `object`, the object is taken for
        the outline of its masks, down to what carries it. `environment_mesh.metadata["origin"]` says of each face whether
        it was seen (0), assumed (1), or bounds what was not seen (2).

        Args:
            views: folder with cameras.json, that file, a point cloud, or `DepthView`s; see `load_views`.
            object: as in `from_files`; None where masks are all that is known of it.
            object_pose: as in `from_files`, with `object`.
            motion: as in `from_files`.
            turn_deg: as in `from_files`.
            tip_deg: as in `from_files`.
            about: as in `from_files`.
            masks: name of the object's masks in the folder, {} for the number of the view: "box_{}.png".
            view_points: (k, 3) where the sensor of a point cloud stood [m, world], or a JSON file with them.
            unseen: space that no view looked into is "solid" or "free".
            voxel: edge of the lattice in which views are fused [m]; 4 mm unless given.
            settle: as in `from_files`.
            surface_noise: as in `from_files`; that of the plane that carries the object if left out.
            clearance: as in `from_files`.
            units: of the object's file.
            length: as in `from_files`.
            validate: as in `from_files`.
            physics: as in `from_files`.

        Raises:
            SceneError: as in `from_files`; or views or masks that cannot be used, or that do not show the object.
            MeshError: the object's mesh cannot be used.
            UnknownNameError: the object is neither a file nor a built-in one.
        """
        from dexnudge.scenes.asked_turn import check_heading
        from dexnudge.scenes.from_depth import scene_from_depth

        check_physics(physics)
        slides = physics.get("motion_length")
        asked = check_heading(motion, turn_deg=turn_deg, tip_deg=tip_deg, about=about, slides=slides)
        far = slides if slides is not None else 0.0 if asked else MOTION_LENGTH
        made = scene_from_depth(
            views,
            object_mesh=None if object is None else object_mesh(object, units=units, length=length),
            object_pose=object_pose,
            way=np.zeros(3) if motion is None else far * unit_motion(motion),
            masks=masks,
            view_points=view_points,
            unseen=unseen,
            voxel=voxel,
        )
        return cls.from_files(
            made.object_mesh,
            environment=made.environment_mesh,
            object_pose=made.T_world_object,
            motion=motion,
            turn_deg=turn_deg,
            tip_deg=tip_deg,
            about=about,
            settle=settle,
            surface_noise=made.noise if surface_noise is None else surface_noise,
            clearance=clearance,
            validate=validate,
            **physics,
        )

    def save(self, folder: str | Path) -> Path:
        """Write scene.json, object.obj and environment.obj into `folder`, made if need be; return scene.json's path.

        Raises:
            OutputError: the folder cannot be written.
        """
        check_path("folder", folder)
        values: dict[str, Any] = {"T_world_object": self.T_world_object, "motion": self.motion}
        values |= {"turn": self.turn.to_json()} if self.turn else {}
        values |= {"uncertainty": self.uncertainty.to_json()} if self.uncertainty else {}
        values |= {key: float(getattr(self, key)) for key in (*NUMBERS, *MARGINS)}
        values |= {"scene": self.name, "parameters": self.parameters, "seed": self.seed}
        return write_scene(values, Path(folder), object_mesh=self.object_mesh, environment_mesh=self.environment_mesh)

    @classmethod
    def load(cls, folder: str | Path) -> Scene:
        """Read a folder that `save` wrote, trusting nothing in it.

        Raises:
            SceneError: a file is missing or damaged, a path leaves the folder, or a value is out of its domain.
            MeshError: a mesh cannot be used.
        """
        check_path("folder", folder, SceneError)
        return cls(**read_scene(Path(folder)))

    @property
    @cached_per_instance
    def supports(self) -> tuple[Support, ...]:
        """Flat surfaces that the object touches, those below it first."""
        found = all_supports(self.object_in_world(), self.environment_mesh, below=TOUCHING)
        return tuple(replace(support, noise=max(support.noise, self.surface_noise)) for support in found)

    @property
    def notes(self) -> list[str]:
        """What was repaired or assumed when the meshes were read, a sentence each."""
        return [
            f"{label}: {note}"
            for label, mesh in (("object", self.object_mesh), ("environment", self.environment_mesh))
            for note in mesh.metadata.get("notes", ())
        ]

    def __repr__(self) -> str:
        size = " x ".join(f"{1e3 * side:.0f}" for side in self.object_mesh.extents)
        motion = ", ".join(f"{each:.2f}" for each in self.motion)
        asked = [f"turn by {np.degrees(self.turn.angle):.0f} deg"] if self.turn else []
        asked += [f"slide {1e3 * self.motion_length:.0f} mm along ({motion})"] if self.motion_length else []
        return (
            f"Scene '{self.name}': object {size} mm, {1e3 * self.mass:.0f} g, to {' and '.join(asked)}; "
            f"friction {self.friction_hand:g} at the hand, {self.friction_environment:g} at the "
            f"surroundings ({len(self.environment_mesh.faces)} triangles)"
        )

    def findings(self, hand: Any = None) -> list[Finding]:
        """Return what is understood of the scene and what is wrong with it, errors first; before anything is sampled.

        hand: the `Hand` whose fingers must find room; left out, nothing is said of them.
        """
        from dexnudge.scenes.findings import scene_findings

        return scene_findings(self, hand)

    def validate(self) -> None:
        """Refuse a scene whose sizes are implausible, or whose object is inside its surroundings or away from them.

        Raises:
            SceneError: naming the length, the depth or the distance, where, and how to mend it; one of the `findings`.
        """
        for finding in self.misplaced:
            raise SceneError(finding.message)

    @property
    @cached_per_instance
    def misplaced(self) -> tuple[Finding, ...]:
        """The errors without whose mending nothing else can be said: of size, or of place (`placement_findings`)."""
        sizes = size_findings(self.object_mesh, self.environment_mesh, self.mass)
        wrong = tuple(finding for finding in sizes if finding.level == "error")
        return wrong or placement_findings(
            self.object_mesh, self.environment_mesh, self.T_world_object, noise=self.surface_noise
        )


def _above_middle(mesh: trimesh.Trimesh, pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3"]:
    """Return a point of the placed object's box [m] that is in front of a sheet even where much of the object is behind it.

    An object that is said to be too deep stands in what carries it, and rarely in what is above it.
    """
    placed = trimesh.transform_points(trimesh.bounds.corners(mesh.bounds), pose)
    low, high = placed.min(axis=0), placed.max(axis=0)
    return np.array([*(low + high)[:2] / 2, low[2] + ABOVE_MIDDLE * (high - low)[2]])


def _heading(mesh: trimesh.Trimesh, pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3"]:
    """Return the direction of the long side of the placed object, seen from above: unit, level, world."""
    return long_side_along_x(trimesh.transform_points(mesh.convex_hull.vertices, pose)[:, :2])[0]


def load_scene(folder: str | Path) -> Scene:
    """Read a folder that `Scene.save` wrote; see `Scene.load`."""
    return Scene.load(folder)


def check_physics(physics: Mapping[str, object]) -> None:
    """Refuse names that are not physical parameters of a scene, and numbers that none can have; SceneError.

    Whether a scene without a turn has a `motion_length` of 0 is left to the scene.
    """
    unknown = sorted(set(physics) - set(NUMBERS))
    if unknown:
        raise SceneError(f"unknown physical parameter {unknown[0]!r}; expected {', '.join(NUMBERS)}")
    for label, value in physics.items():
        _check_number(label, value, minimum_excluded=label in POSITIVE)


def _check_number(label: str, value: object, *, minimum_excluded: bool) -> None:
    too_long = isinstance(value, int) and abs(value) > LARGEST_NUMBER  # perhaps for a float
    number = np.inf if too_long else float(value) if isinstance(value, Real) else np.nan
    shown = quote(value)
    if not np.isfinite(number) or number < 0 or (minimum_excluded and number == 0):
        raise SceneError(f"`{label}` is {shown}; expected a finite number {'> 0' if minimum_excluded else '>= 0'}")
    if label == "motion_length" and 0 < number < SHORTEST_MOTION:
        raise SceneError(f"`motion_length` is {shown} m; expected at least {SHORTEST_MOTION:g} m")
    if label == "motion_length" and number > LONGEST_MOTION:
        meant = f"is it in millimetres? give {number / 1000:g}" if number <= 1000 * LONGEST_MOTION else "give metres"
        raise SceneError(f"`motion_length` is {number:g} m; expected at most {LONGEST_MOTION:g} m; {meant}")
    if number > LARGEST_NUMBER:
        raise SceneError(f"`{label}` is {number:g}; expected at most {LARGEST_NUMBER:g}")
