"""`dexnudge hand`: what a hand consists of, and its export."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from dexnudge.cli.arguments import Flag, OptionalCount, OptionalFolder, OptionalNumber, metavar, say, stdout, table

if TYPE_CHECKING:
    from dexnudge.hands.hand import Hand

MARKER = "hand.urdf"


@dataclass(frozen=True)
class HandCommand:
    """Show the links, joints, limits, digits and collision pairs of a hand, and export it."""

    hand: tyro.conf.Positional[Annotated[str, metavar("NAME_OR_URDF")]]
    """Built-in hand, or a URDF or MJCF file with its YAML beside it; an unknown name lists the built-in ones."""
    export: OptionalFolder = None
    """Folder to write URDF, meshes, YAML and MJCF to; must not exist."""
    base: Flag = True
    """Leave the forearm out of the hand's geometry."""
    overwrite: Flag = False
    """Replace an existing exported hand; other files in its folder stay."""

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
        """Write the folder if asked; print the tables."""
        if self.learn:
            from dexnudge.cli.hand_learning import learn

            return learn(
                self.hand, out=self.out, base=self.base, minutes=self.minutes, workers=self.workers, seed=self.seed
            )
        from dexnudge.hands.registry import load_hand

        if self.export is None:
            _print(load_hand(self.hand, base=self.base))
            return 0
        from dexnudge.hands.export import HAND_FILES, export_hand
        from dexnudge.jobs.folders import new_folder

        with new_folder(
            self.export, overwrite=self.overwrite, marker=MARKER, ours=HAND_FILES, argument="export"
        ) as folder:
            hand = load_hand(self.hand, base=self.base)
            export_hand(hand, folder)
        _print(hand)
        say(f"written: {self.export}")
        return 0


def _print(hand: Hand) -> None:
    import numpy as np

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
    for note in hand.notes:
        say(f"note: {note}")
    console.print(f"palm: {hand.link_names[0]}, facing ({', '.join(f'{x:g}' for x in hand.palm_normal)})")
    say(f"couplings: {couplings or 'none'}", f"collision pairs: {len(hand.self_collision_pairs)}")
