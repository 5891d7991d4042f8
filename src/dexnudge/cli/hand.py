"""`dexnudge hand`: what a hand consists of, what was assumed, and a prepared folder of it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from dexnudge.cli.arguments import (
    NOTHING_SUCCEEDED,
    Flag,
    OptionalCount,
    OptionalFolder,
    OptionalNumber,
    check_at_least,
    metavar,
    named_folders,
    refuse_without,
    say,
    stdout,
    table,
)
from dexnudge.errors import InputError, OutputError, SceneError, check_path
from dexnudge.jobs.json_files import read_json_object

if TYPE_CHECKING:
    from dexnudge.hands.hand import Hand
    from dexnudge.hands.preparation import PreparedHand


DESCRIPTION, FINDINGS, PICTURE, PAGE = "hand.urdf", "findings.json", "hand.png", "hand.html"
FORMAT = "dexnudge prepared hand 1"  # of findings.json, which nothing else writes so: the mark of a prepared folder


@dataclass(frozen=True)
class HandCommand:
    """Show what a hand consists of and what was assumed about it, and write it as a prepared folder.

    Any URDF or MJCF does: palm, fingertips and the direction in which the palm faces are found where no YAML beside it
    states them; an arm above the palm is cut off. What is no hand is refused, with what is missing.
    """

    hand: tyro.conf.Positional[Annotated[str, metavar("NAME_OR_FILE")]]
    """Built-in hand, URDF or MJCF file, or prepared folder; an unknown name lists the built-in ones."""
    prepare: OptionalFolder = None
    """Folder to write description, YAML, meshes, picture and findings to; --hand takes it everywhere."""
    palm: Annotated[str | None, metavar("LINK")] = None
    """Link from which the digits branch; found unless given. Of a robot with two hands, one's palm."""
    palm_normal: Annotated[tuple[float, float, float] | None, metavar("X Y Z")] = None
    """Direction in which the palm faces, in the palm's frame; found unless given."""
    geometry: Annotated[Literal["collision", "visual"] | None, metavar("KIND")] = None
    """Which geometry counts, collision or visual; collision unless a hand has none."""
    package: tyro.conf.UseAppendAction[Annotated[tuple[str, ...], metavar("NAME=DIR")]] = ()
    """Folder of a ROS package whose meshes the description names by package://NAME. Repeatable."""
    base: Flag = True
    """Leave the forearm out of the hand's geometry."""
    overwrite: Flag = False
    """Replace the files that this command wrote to an existing prepared folder; other files in it stay."""

    learn: Flag = False
    """Learn the hand: data, training and evaluation in its prepared folder, or in --out; goes on where it was stopped."""
    minutes: OptionalNumber = None
    """With --learn: wall-clock time for all of it; 60 unless given."""
    out: OptionalFolder = None
    """With --learn: folder to prepare a named hand or a description in, and to learn it in."""
    workers: OptionalCount = None
    """With --learn: processes; one for each core unless given."""
    seed: OptionalCount = None
    """With --learn: of data, training and evaluation; 0 unless given."""

    def run(self) -> int:
        """Write the folder if asked, learn in it if asked; print the tables and the findings."""
        if self.learn:  # what cannot be is said before a hand is prepared, which takes seconds
            from dexnudge.experiments.learning.plan import check_minutes

            check_at_least(1, workers=self.workers)
            check_at_least(0, seed=self.seed)
            check_minutes(self.minutes)
            return self._learn(self._learning_folder())
        refuse_without("learn", self, "minutes", "out", "workers", "seed")
        if self.prepare is None:
            refuse_without("prepare", self, "overwrite")
        prepared = self._prepared() if self.prepare is None else self._write(self.prepare)
        _print(prepared)
        if self.prepare is not None:
            say(
                f"written: {self.prepare}",
                f"look at it: {Path(self.prepare) / PICTURE}, or turn it in {Path(self.prepare) / PAGE}",
                f"change what was assumed: edit {Path(self.prepare) / 'hand.yaml'}, then dexnudge hand {self.prepare}",
                f"use it: dexnudge hand {self.prepare} --learn, then dexnudge sample phone --hand {self.prepare}; "
                "without learning, sample --method random_start_projection",
            )
        return 0

    def _write(self, out: str) -> PreparedHand:
        from dexnudge.hands.export import export_hand
        from dexnudge.jobs.folders import new_folder
        from dexnudge.viewer.hand_view import write_hand_page
        from dexnudge.viewer.picture import write_png
        from dexnudge.viewer.robot_pictures import hand_picture

        argument = "prepare" if self.prepare is not None else "out"
        former = self._replaceable(out, argument) if self.overwrite else ()
        with new_folder(out, overwrite=self.overwrite, marker=FINDINGS, ours=former, argument=argument) as folder:
            prepared = self._prepared()
            export_hand(prepared.hand, folder)
            write_png(hand_picture(prepared.hand), folder / PICTURE)
            write_hand_page(prepared.hand, folder / PAGE)
            files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
            content = {"format": FORMAT, "files": files, "findings": [each.as_dict() for each in prepared.findings]}
            (folder / FINDINGS).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        return prepared

    def _replaceable(self, out: str, argument: str) -> Sequence[str]:
        """Return the files of the folder `out` that this command wrote; refuse others' folders and the hand's own."""
        check_path("hand", self.hand)
        check_path(argument, out)
        folder, source = Path(out).resolve(), Path(self.hand).resolve()
        if source.exists() and folder in (source, *source.parents):
            raise OutputError(
                f"the output folder {out} holds the description {self.hand}; expected another folder, as what is read is "
                f"never replaced; choose another `{argument}`"
            )
        if not out or not folder.is_dir() or not any(folder.iterdir()):
            return ()
        former = _files_written(folder / FINDINGS)
        if not former:
            raise OutputError(
                f"the output folder {out} exists and was not written by this command: expected {FINDINGS} with the format "
                f"'{FORMAT}'; `overwrite` replaces only such folders; choose another `{argument}`"
            )
        return former

    def _learning_folder(self) -> Path:
        """Return the prepared folder to learn in, made if need be."""
        from dexnudge.hands.registry import load_hand

        out = self.out if self.prepare is None else self.prepare
        if out is None and (Path(self.hand) / DESCRIPTION).is_file():
            refuse_without("prepare", self, "palm", "palm_normal", "geometry", "package", "overwrite")
            return Path(self.hand)
        if out is None:
            raise InputError(
                f"{self.hand} is no prepared folder to learn in; expected one, or `out`, the folder to make"
            )
        if not (Path(out) / DESCRIPTION).is_file():
            _print(self._write(out))  # what was assumed is seen before an hour is spent on it
            return Path(out)
        hand, there = self._prepared().hand, load_hand(out)
        if (there.name, there.joint_names) != (hand.name, hand.joint_names):
            raise InputError(f"{out} holds the hand '{there.name}', not '{hand.name}'; choose another `out`")
        return Path(out)

    def _learn(self, folder: Path) -> int:
        from dexnudge.experiments.learning.learn import learn_hand

        learned = learn_hand(folder, minutes=self.minutes, workers=self.workers, seed=self.seed, say=say)
        say(learned.report, f"written: {folder}")
        return 0 if learned.succeeded else NOTHING_SUCCEEDED

    def _prepared(self) -> PreparedHand:
        from dexnudge.hands.preparation import prepare_hand

        return prepare_hand(
            self.hand,
            palm=self.palm,
            palm_normal=self.palm_normal,
            geometry=self.geometry,
            base=self.base,
            packages=named_folders("package", self.package),
        )


def _files_written(path: Path) -> tuple[str, ...]:
    """Return the files beside this findings.json that were written with it; none if it is not this command's."""
    try:
        content = read_json_object(path)
    except SceneError:
        return ()
    if content.get("format") != FORMAT or not isinstance(content.get("files"), list):
        return ()
    return tuple(file for file in content["files"] if isinstance(file, str) and file)


def _print(prepared: PreparedHand) -> None:
    from dexnudge.cli.scene_options import say_findings

    _print_tables(prepared.hand)
    say_findings(prepared.findings, HandCommand)


def _print_tables(hand: Hand) -> None:
    import numpy as np

    from dexnudge.hands.checks import direction_numbers

    console = stdout()
    console.print(f"{hand.name}: {len(hand.link_names)} links, {hand.num_joints} joints in the order of q")
    unit = "deg, mm of slides" if hand.sliding.any() else "deg"
    joints = table("joint", f"lower [{unit}]", f"upper [{unit}]")
    units = np.where(hand.sliding, 1e3, 180.0 / np.pi)
    for joint, lower, upper in zip(hand.joint_names, hand.lower * units, hand.upper * units, strict=True):
        joints.add_row(joint, f"{lower:.1f}", f"{upper:.1f}")
    console.print(joints)
    links = table("link", "parent", "digit", "triangles", "collision pairs")
    for index, name in enumerate(hand.link_names):
        parent, digit = int(hand.link_parent[index]), hand.digit_of_link[name] or "-"
        links.add_row(
            name,
            hand.link_names[parent] if parent >= 0 else "-",
            f"{digit}, tip" if name in hand.fingertip_links else digit,
            str(len(hand.link_meshes[index].faces)),
            str(sum(index in pair for pair in hand.self_collision_pairs)),
        )
    console.print(links)
    couplings = ", ".join(f"{follower} <= {leader}" for follower, leader in hand.couplings)
    say(
        f"palm: {hand.link_names[0]}, facing {direction_numbers(hand.palm_normal)}", f"couplings: {couplings or 'none'}"
    )
