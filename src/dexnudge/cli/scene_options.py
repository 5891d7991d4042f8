"""The scene that `sample` and `scene` are about: its options, and how its findings are printed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from dexnudge.cli.arguments import (
    Count,
    Flag,
    MeshOptions,
    OptionalFolder,
    OptionalNumber,
    Physics,
    Text,
    Turning,
    check_at_least,
    given,
    metavar,
    say,
)
from dexnudge.errors import InputError, SceneError, printable_name

if TYPE_CHECKING:
    from dexnudge.finding import Finding
    from dexnudge.hands.hand import Hand
    from dexnudge.scenes.scene import Scene

RUNS = Path("runs")  # unless --out is given
LONGEST_WORD = 100  # bytes of an object's or a scene's name in that of a folder
SCENE_FILE = "scene.json"  # makes a folder one with a scene; also stands in scenes/files.py, which is slow to import
MASKED = "masked"  # in the place of an object's file or name
SOURCES = ("scene", "environment", "depth")  # where surroundings come from
MATTER = ("size", "supports", "settled", "free_way", "repaired")  # notes that `sample` prints


@dataclass(frozen=True, kw_only=True)
class SceneOptions(MeshOptions):
    """The scene is drawn from a family, your own from a mesh or from depth images, or that of a folder."""

    object: tyro.conf.Positional[Annotated[str, metavar("OBJECT")]]
    """Mesh file (obj, stl, ply, glb, off, dae), name of a built-in object (an unknown name lists them), or a folder that
    `scene` wrote; with --depth also "masked", for one of which only masks are known."""
    scene: Annotated[str | None, metavar("FAMILY")] = None
    """Scene family, such as table, layers or shelf; an unknown name lists them."""
    environment: Annotated[str | None, metavar("MESH")] = None
    """Mesh file of your own surroundings, world frame, z up."""
    depth: OptionalFolder = None
    """Folder of depth images of your own surroundings, with cameras.json."""
    object_pose: Annotated[str | None, metavar("JSON")] = None
    """File with T_world_object, the 4x4 pose of the object in those surroundings."""
    motion: Annotated[tuple[float, float, float] | None, metavar("DX DY DZ")] = None
    """Direction in which the object should slide, world frame; with --environment and --depth."""
    masks: Annotated[str | None, metavar("NAME")] = None
    """With --depth: name of the object's masks in the folder, {} for the number of the view: box_{}.png."""
    unseen: Literal["solid", "free"] = "solid"
    """With --depth: what space is that no view looked into."""
    motion_length: OptionalNumber = None
    """How far it should slide [m]; unless given 0.1 or as the family has it, in surroundings of your own 0 after --turn or
    --tip."""
    turning: Turning = field(default_factory=Turning)
    settle: Literal["auto", "off"] = "auto"
    """Move the object by up to 5 mm and 3 degrees onto what carries it, or leave it as it is."""
    surface_noise: OptionalNumber = None
    """By how much the surfaces of --environment or --depth scatter, root mean square [m]; measured unless given."""
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
        return self.scene or _short(printable_name(Path(self.environment or self.depth or "").stem))

    @property
    def label(self) -> str:
        """What names the object in the names of folders."""
        from dexnudge.objects.sets import name_of

        return _short(name_of(Path(self.object)))

    @property
    def is_folder(self) -> bool:
        """Whether the object is a folder with a scene in it."""
        return (Path(self.object) / SCENE_FILE).is_file()

    def check_options(self) -> None:
        """Refuse options that contradict each other; InputError."""
        check_at_least(0, seed=self.seed)
        given = {name: getattr(self, name) for name in SOURCES}
        own = {name: getattr(self, name) for name in ("object_pose", "motion", "surface_noise")}
        turning = self.turning.given()
        own |= {"settle": None if self.settle == "auto" else self.settle}
        seen = {"masks": self.masks, "unseen": None if self.unseen == "solid" else self.unseen}
        if self.is_folder:
            meshes = {"units": None if self.units == "m" else self.units, "length": self.length}
            _refuse(
                {**given, **own, **vars(self.turning), **seen, **meshes},
                f"the scene of the folder {self.object}, which has its own; make another scene",
            )
            return
        from dexnudge.scenes.motion import check_asked

        check_asked(**{"turn_deg": None, "tip_deg": None, "about": None} | turning)
        named = [f"`{name}`" for name, value in given.items() if value is not None]
        if len(named) != 1:
            got = (
                f"{' and '.join(named)} given together" if named else "none of `scene`, `environment` and `depth` given"
            )
            raise InputError(
                f"{got}; expected one: `scene` table, `environment` MESH with `object_pose` JSON and `motion` DX DY DZ, or "
                "`depth` DIR with `motion`"
            )
        if self.object == MASKED and self.depth is None:
            raise InputError(
                f"OBJECT is {MASKED!r} without `depth`; expected a mesh file, or depth images with masks of the object"
            )
        if self.scene is not None:
            _refuse({**own, **seen}, "`scene`, which draws its own; use `environment`")
            return
        if self.depth is None:
            _refuse(seen, "`environment`, which has no views; use `depth`")
        needed = [*(["object_pose"] if self.object != MASKED else []), *([] if "turn_deg" in turning else ["motion"])]
        missing = [f"`{name}`" for name in needed if own[name] is None]
        if missing:
            raise InputError(f"{named[0]} needs {' and '.join(missing)} too; add what is missing")

    def build(self) -> tuple[str, Scene]:
        """Return the object's name and the scene, which may be misplaced: its findings say so."""
        from dexnudge.scenes.scene import Scene

        values = self.physics.given()
        values |= {} if self.motion_length is None else {"motion_length": self.motion_length}
        margins: dict[str, Any] = {} if self.clearance is None else {"clearance": self.clearance}
        if self.is_folder:
            folder = Path(self.object)
            return printable_name(folder.resolve().name), replace(Scene.load(folder), **values, **margins)
        name, mesh = self._object()
        if self.scene is not None:
            from dexnudge.scenes.families import build_scene

            return name, replace(
                build_scene(self.scene, mesh, seed=self.seed, **values, **self.turning.given()), **margins
            )
        values |= {
            **self.turning.given(),
            "settle": self.settle,
            "surface_noise": self.surface_noise,
            **margins,
            "validate": False,
        }
        if self.depth is not None:
            return name, Scene.from_depth(
                self.depth,
                object=mesh,
                object_pose=self.object_pose,
                motion=self.motion,
                masks=self.masks,
                unseen=self.unseen,
                **values,
            )
        assert self.environment is not None
        assert self.object_pose is not None
        return name, Scene.from_files(
            mesh,
            environment=self.environment,
            object_pose=self.object_pose,
            motion=self.motion,
            units=self.units,
            **values,
        )

    def _object(self) -> tuple[str, Any]:
        """Return the object's name and its mesh [m]; None for one that only masks show."""
        if self.object == MASKED:
            for name in given(self, "units", "length"):
                raise InputError(
                    f"`{name}` is given for {MASKED!r}, which has no mesh; its size is that of the images; leave it out"
                )
            return MASKED, None
        from dexnudge.objects.builtin import is_builtin
        from dexnudge.objects.sets import refuse_units, resolve_object

        found = resolve_object(self.object, units=self.units, length=self.length)
        if self.environment is None and is_builtin(self.object):
            refuse_units(self.object, self.units)
        return found.name, found.mesh

    def what_matters(self, scene: Scene, hand: Hand) -> list[Finding]:
        """Return the findings before sampling; of a family, which is built to be right, only about the meshes and errors."""
        if self.is_folder:  # whoever made it was told how its object was settled
            return [finding for finding in scene.findings(hand) if finding.what != "settled"]
        if self.scene is None or self.turning.given():
            return scene.findings(hand)
        from dexnudge.scenes.findings import reading_findings

        return [*reading_findings(scene), *scene.misplaced]


def _short(name: str) -> str:
    """Return the beginning of a name; two of them, and a number, are the name of a folder."""
    return name.encode()[:LONGEST_WORD].decode(errors="ignore")


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
