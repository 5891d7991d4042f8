"""`dexnudge arm`: what an arm consists of, what was assumed, and a picture of it with a hand."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from dexnudge.cli.arguments import Flag, OptionalFolder, metavar, say, stdout, table
from dexnudge.cli.arm_options import MountOptions
from dexnudge.errors import InputError

if TYPE_CHECKING:
    from dexnudge.arms.arm import Arm
    from dexnudge.arms.robot import Robot

PICTURE = "arm.png"
LIMITS = ("velocity", "acceleration", "jerk", "effort")


@dataclass(frozen=True)
class ArmCommand(MountOptions):
    """Show an arm: joints and their limits, reach, flange and home, what was assumed, and a picture of it with a hand.

    Any URDF or MJCF does. What it does not state comes from a YAML beside it; what is missing is said, with the lines to
    write.
    """

    arm: tyro.conf.Positional[Annotated[str, metavar("NAME_OR_FILE")]]
    """Built-in arm, or a URDF or MJCF file; an unknown name lists them."""
    hand: Annotated[str | None, metavar("NAME")] = None
    """Hand that it carries: built-in, or a URDF or MJCF file."""
    out: OptionalFolder = None
    """Folder to write the picture, arm.png, to."""
    overwrite: Flag = False
    """Replace the picture that an earlier call wrote there."""

    def run(self) -> int:
        """Print the tables and the notes; write the picture if asked."""
        from dexnudge.arms.mounting import mount
        from dexnudge.hands.registry import load_hand

        if self.mount and self.hand is None:
            raise InputError("`mount` given without `hand`; name the hand, or leave it out")
        arm = self.loaded(self.arm)
        _print(arm)
        robot = None if self.hand is None else mount(arm, load_hand(self.hand), self.T_flange_mount())
        if robot is not None:
            _print_mount(robot)
        if self.out is not None:
            self._write(robot or arm, self.out)
        return 0

    def _write(self, shown: Arm | Robot, out: str) -> None:
        from dexnudge.jobs.folders import new_folder
        from dexnudge.viewer.picture import write_png
        from dexnudge.viewer.robot_pictures import arm_picture

        with new_folder(out, overwrite=self.overwrite, marker=PICTURE) as folder:
            write_png(arm_picture(shown), folder / PICTURE)
        say(f"look at it: {Path(out) / PICTURE}")


def _print(arm: Arm) -> None:
    slides = any(joint.slides for joint in arm.chain)
    units = "rad, s, N m; of joints that slide m, s, N" if slides else "rad, s, N m"
    stdout().print(f"{arm.name}: {len(arm.tree.links)} links, {arm.num_joints} joints; in {units}:")
    rows = table("joint", "lower", "upper", "home", *LIMITS)
    limits = vars(arm.limits)
    for index, name in enumerate(arm.joint_names):
        places = (each[index] for each in (arm.limits.lower, arm.limits.upper, arm.home))
        rows.add_row(name, *(f"{place:.4f}" for place in places), *(f"{limits[key][index]:g}" for key in LIMITS))
    stdout().print(rows)
    x, y, z = arm.flange_poses(arm.home[None])[0, :3, 3]
    say(
        f"base: {arm.base}; flange: {arm.flange}, at home at ({x:.3f}, {y:.3f}, {z:.3f}) m; "
        f"reach {arm.reach:.3f} m from base to flange",
        *(f"note: {note}" for note in arm.notes),
    )


def _print_mount(robot: Robot) -> None:
    from scipy.spatial.transform import Rotation

    place = robot.T_flange_mount[:3, 3]
    with warnings.catch_warnings():  # at a pitch of 90 degrees one of the angles is free
        warnings.simplefilter("ignore")
        turn = Rotation.from_matrix(robot.T_flange_mount[:3, :3]).as_euler("xyz", degrees=True)
    numbers = " ".join(f"{value + 0.0:.4g}" for value in [*place.round(6), *turn.round(4)])
    say(f"{robot.hand.name} is mounted by its '{robot.mount}' at: --mount {numbers}")
