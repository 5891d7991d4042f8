"""The arm that `arm`, `sample`, `plan` and `find-base` are about: its options, and poses typed by hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from dexnudge.cli.arguments import is_number, metavar, named_folders
from dexnudge.errors import ArmError, SceneError

if TYPE_CHECKING:
    import numpy as np

    from dexnudge.arms.arm import Arm
    from dexnudge.arms.robot import Robot
    from dexnudge.experiments.arm_trial import ArmTrial
    from dexnudge.hands.hand import Hand
    from dexnudge.scenes.scene import Scene

Pose = Annotated[tuple[str, ...], metavar("JSON|X Y Z [ROLL PITCH YAW]")]


@dataclass(frozen=True, kw_only=True)
class MountOptions:
    """How the hand is mounted, and where the arm's meshes are."""

    mount: Pose = ()
    """Pose of the hand's base, or of its palm where it has none, in the flange's frame: a JSON file with T_flange_mount, or
    metres and degrees; one that fits hand and arm unless given."""
    package: tyro.conf.UseAppendAction[Annotated[tuple[str, ...], metavar("NAME=DIR")]] = ()
    """Folder of a ROS package whose meshes the arm's description names by package://NAME. Repeatable."""

    def T_flange_mount(self) -> np.ndarray | None:
        """Return the pose that the user gave; None without one."""
        return typed_pose("mount", self.mount, "T_flange_mount")

    def loaded(self, name: str) -> Arm:
        """Return the arm of that name or file, its meshes found."""
        from dexnudge.arms.registry import load_arm

        return load_arm(name, packages=named_folders("package", self.package))


@dataclass(frozen=True, kw_only=True)
class ArmOptions(MountOptions):
    """The arm that carries the hand, and where it stands."""

    arm: Annotated[str | None, metavar("NAME_OR_FILE")] = None
    """Built-in arm, or a URDF or MJCF file; an unknown name lists them."""
    arm_base: Pose = ()
    """Where it stands: a JSON file with T_world_base, or metres and degrees; 0.7 m from the object in the direction of its
    motion unless given."""

    def robot(self, hand: Hand, scene: Scene) -> Robot | None:
        """Return the arm with the hand where it stands in a scene; None without an arm.

        Raises:
            ArmError, UnknownNameError: no such arm, or it cannot stand or carry the hand so.
        """
        from dexnudge.arms.mounting import mount
        from dexnudge.arms.standing import check_base

        if self.arm is None:
            _refuse_without_arm(self, "arm_base", "mount", "package")
            return None
        robot = mount(standing_arm(self.loaded(self.arm), self.arm_base, scene), hand, self.T_flange_mount())
        check_base(robot, scene)
        return robot


@dataclass(frozen=True, kw_only=True)
class EvaluatedArm(MountOptions):
    """The arm for which `evaluate` plans, and where it stands in each scene."""

    arm: Annotated[str | None, metavar("NAME_OR_FILE")] = None
    """Plan for this arm: built-in, or a URDF or MJCF file; with --execute play the plans, with
    --then-grasp up to a lift. Nothing else is run."""
    arm_base: Pose = ()
    """Where it stands in every scene: a JSON file with T_world_base, or metres and degrees."""
    base_distance: Annotated[tuple[float, ...], metavar("FROM TO")] = ()
    """How far from the object it stands [m], in the direction of its motion: drawn for each scene from these bounds, or one
    number; 0.6 unless given."""

    def trial(self, *, execute: bool, then_grasp: bool) -> ArmTrial | None:
        """Return the kind of trial that plans for the arm; None without one.

        Raises:
            InputError, ArmError, UnknownNameError: options that do not go together, no such arm, or no pose.
        """
        if self.arm is None:
            _refuse_without_arm(self, "arm_base", "base_distance", "mount", "package")
            return None
        from dexnudge.experiments.arm_trial import ArmTrial

        self.loaded(self.arm)  # refuses what is none, before anything is written
        base, mount = _tuples(typed_pose("arm_base", self.arm_base, "T_world_base")), _tuples(self.T_flange_mount())
        bounds = self._bounds(has_base=base is not None) if self.base_distance else ArmTrial.base_distance
        return ArmTrial(
            self.arm,
            base=base,
            mount=mount,
            base_distance=bounds,
            packages=tuple(named_folders("package", self.package).items()),
            execute=execute,
            then_grasp=then_grasp,
        )

    def _bounds(self, *, has_base: bool) -> tuple[float, float]:
        given = self.base_distance
        if has_base:
            raise ArmError("`arm_base` and `base_distance` are both given; expected one of them")
        if len(given) > 2 or not all(0.1 <= value <= 3.0 for value in given) or given[0] > given[-1]:
            raise ArmError(
                f"`base_distance` is {' '.join(f'{value:g}' for value in given)}; expected one number, or FROM TO with FROM "
                "at most TO, from 0.1 to 3 m"
            )
        return given[0], given[-1]


def _tuples(pose: np.ndarray | None) -> tuple[tuple[float, ...], ...] | None:
    return None if pose is None else tuple(map(tuple, pose.tolist()))


def _refuse_without_arm(options: MountOptions, *names: str) -> None:
    given = [f"`{name}`" for name in names if getattr(options, name)]
    if given:
        raise ArmError(f"{' and '.join(given)} given without `arm`; name the arm, or leave it out")


def standing_arm(arm: Arm, words: tuple[str, ...], scene: Scene) -> Arm:
    """Return the arm where `arm_base` puts it, or where it stands sensibly in a scene."""
    from dexnudge.arms.standing import default_base

    base = typed_pose("arm_base", words, "T_world_base")
    return arm.standing_at(default_base(arm, scene) if base is None else base)


def typed_pose(argument: str, words: tuple[str, ...], key: str) -> Any:
    """Return the (4, 4) pose that the words of an option mean; None without any.

    words: a JSON file; or x, y, z [m], and roll, pitch and yaw [deg], as URDF has them: about the fixed axes x, y, z.

    Raises:
        ArmError: neither, or no rigid pose.
    """
    if not words:
        return None
    if len(words) == 1 and not is_number(words[0]):
        from dexnudge.scenes.files import load_pose

        try:
            return load_pose(Path(words[0]), key, argument)
        except SceneError as error:
            raise ArmError(f"`{argument}`: {error}") from error
    if len(words) not in (3, 6) or not all(map(is_number, words)):
        raise ArmError(
            f"`{argument}` got {' '.join(words)}; expected a JSON file, or X Y Z [m] and, for a turn, ROLL PITCH YAW [deg]"
        )
    import numpy as np
    from scipy.spatial.transform import Rotation

    from dexnudge.arms.arm import rigid_pose

    numbers = np.array([float(word) for word in words])
    if not np.isfinite(numbers).all():
        raise ArmError(f"`{argument}` got {' '.join(words)}; expected finite numbers")
    pose = np.eye(4)
    pose[:3, 3] = numbers[:3]
    if len(numbers) == 6:
        pose[:3, :3] = Rotation.from_euler("xyz", numbers[3:], degrees=True).as_matrix()
    return rigid_pose(pose, f"`{argument}`")
