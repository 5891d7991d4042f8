"""The scene that `sample` and `scene` are about: its options, and how its findings are printed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from dexnudge.cli.arguments import Count, Flag, MeshOptions, OptionalNumber, Physics, Text, check_at_least, metavar, say
from dexnudge.errors import InputError, SceneError

if TYPE_CHECKING:
    from dexnudge.hands.hand import Hand
    from dexnudge.scenes.finding import Finding
    from dexnudge.scenes.scene import Scene

RUNS = Path("runs")  # unless --out is given
SCENE_FILE = (
    "scene.json"  # what makes a folder one with a scene; the name stands in scenes/files.py, which is slow to import
)
MATTER = ("size", "supports", "free_way", "repaired")  # notes that `sample` prints


@dataclass(frozen=True, kw_only=True)
class SceneOptions(MeshOptions):
    """The scene is drawn from a family (--scene), your own (--environment, --object-pose, --motion), or a folder's."""

    object: tyro.conf.Positional[Annotated[str, metavar("OBJECT")]]
    """Mesh file (obj, stl, ply, glb, off, dae), name of a built-in object (an unknown name lists them), or a folder that
    `scene` wrote."""
    scene: Annotated[str | None, metavar("FAMILY")] = None
    """Scene family, such as table, layers or shelf; an unknown name lists them."""
    environment: Annotated[str | None, metavar("MESH")] = None
    """Mesh file of your own surroundings, world frame, z up."""
    object_pose: Annotated[str | None, metavar("JSON")] = None
    """File with T_world_object, the 4x4 pose of the object in those surroundings."""
    motion: Annotated[tuple[float, float, float] | None, metavar("DX DY DZ")] = None
    """Direction in which the object should slide, world frame; with --environment."""
    motion_length: OptionalNumber = None
    """How far it should slide [m]; 0.1 unless given."""
    settle: Literal["auto", "off"] = "auto"
    """With --environment: move the object by up to 5 mm and 3 degrees onto what carries it, or leave it as it is."""
    surface_noise: OptionalNumber = None
    """With --environment: by how much its surfaces scatter, root mean square [m]; measured unless given."""
    clearance: OptionalNumber = None
    """Distance that hands keep from the surroundings [m]; at least the surface noise."""
    seed: Count = 0
    """Same machine, seed and versions: same output."""
    hand: Text = "shadow_lite"
    """Built-in hand, or a URDF or MJCF file; an unknown name lists them."""
    base: Flag = True
    """Leave the forearm out of the hand's geometry."""
    physics: Physics = field(default_factory=Physics)

    @property
    def place(self) -> str:
        """What names the scene in the names of folders."""
        if self.is_folder:
            return "scene"
        return self.scene or Path(self.environment or "").stem

    @property
    def is_folder(self) -> bool:
        """Whether the object is a folder with a scene in it."""
        return (Path(self.object) / SCENE_FILE).is_file()

    def check_options(self) -> None:
        """Refuse options that contradict each other; InputError."""
        check_at_least(0, seed=self.seed)
        own = {"object_pose": self.object_pose, "motion": self.motion}
        measured = {"settle": None if self.settle == "auto" else "off", "surface_noise": self.surface_noise}
        sources = {"scene": self.scene, "environment": self.environment}
        if self.is_folder:
            meshes = {"units": None if self.units == "m" else self.units, "length": self.length}
            _refuse(
                {**sources, **own, **measured, **meshes}, f"the scene of the folder {self.object}, which has its own"
            )
            return
        if (self.scene is None) == (self.environment is None):
            got = "neither" if self.scene is None else "both"
            raise InputError(
                f"{got} of `scene` and `environment` given; expected one: `scene` table, or `environment` MESH with "
                "`object_pose` JSON and `motion` DX DY DZ"
            )
        if self.scene is not None:
            _refuse({**own, **measured}, "`scene`, which draws its own; use `environment`")
            return
        missing = [f"`{name}`" for name, value in own.items() if value is None]
        if missing:
            raise InputError(f"`environment` needs {' and '.join(missing)} too; add what is missing")

    def build(self) -> tuple[str, Scene]:
        """Return the object's name and the scene, which may be misplaced: its findings say so."""
        values = self.physics.given()
        values |= {} if self.motion_length is None else {"motion_length": self.motion_length}
        margins: dict[str, Any] = {} if self.clearance is None else {"clearance": self.clearance}
        if self.is_folder:
            from dexnudge.scenes.scene import Scene

            return Path(self.object).resolve().name, replace(Scene.load(self.object), **values, **margins)
        from dexnudge.objects.builtin import is_builtin
        from dexnudge.objects.sets import refuse_units, resolve_object

        found = resolve_object(self.object, units=self.units, length=self.length)
        if self.scene is not None:
            if is_builtin(self.object):
                refuse_units(self.object, self.units)
            from dexnudge.scenes.families import build_scene

            return found.name, replace(build_scene(self.scene, found.mesh, seed=self.seed, **values), **margins)
        from dexnudge.scenes.scene import Scene

        assert self.environment is not None
        assert self.object_pose is not None
        assert self.motion is not None
        scene = Scene.from_files(
            found.mesh,
            environment=self.environment,
            object_pose=self.object_pose,
            motion=self.motion,
            units=self.units,
            settle=self.settle,
            surface_noise=self.surface_noise,
            validate=False,
            **values,
            **margins,
        )
        return found.name, scene

    def what_matters(self, scene: Scene, hand: Hand) -> list[Finding]:
        """Return the findings before sampling; of a scene of a family, which is built to be right, only sizes and errors."""
        if self.scene is None or self.is_folder:
            return scene.findings(hand)
        from dexnudge.scenes.sizes import size_findings

        sizes = size_findings(scene.object_mesh, scene.environment_mesh, scene.mass)
        return [*(finding for finding in sizes if finding.level != "error"), *scene.misplaced]


def _refuse(options: dict[str, Any], why: str) -> None:
    given = [f"`{name}`" for name, value in options.items() if value is not None]
    if given:
        raise InputError(f"{' and '.join(given)} given with {why}, or leave it out")


def say_findings(findings: Sequence[Finding], command: Any, *, only_what_matters: bool = False) -> None:
    """Print findings, a line each: all, or warnings and the notes that matter before sampling; errors are for `stop`."""
    from dexnudge.cli.arguments import with_flags

    for finding in findings:
        matters = finding.level == "warning" or finding.what in MATTER
        if finding.level != "error" and (matters or not only_what_matters):
            say(with_flags(str(finding), command))


def stop_at_errors(findings: Sequence[Finding]) -> None:
    """Raise the errors among findings as one SceneError, a line each; nothing without any."""
    errors = [finding.message for finding in findings if finding.level == "error"]
    if errors:
        raise SceneError("\n".join(errors))
