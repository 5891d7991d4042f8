"""What a result folder offers to be executed."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int

from dexnudge.errors import InputError
from dexnudge.hands.hand import Hand
from dexnudge.results.configurations import Configurations, load_configurations
from dexnudge.results.writing import read_problem
from dexnudge.scenes.scene import Scene


@dataclass(frozen=True)
class VerifiedFolder:
    """A scene, a hand, its configurations, and which of them are verified, best first; at least one is."""

    scene: Scene
    hand: Hand
    configurations: Configurations
    verified: Int[np.ndarray, " n"]


def read_verified(folder: Path) -> VerifiedFolder:
    """Read a folder that `sample` wrote.

    Raises:
        InputError: files are missing, damaged or do not belong together, or no configuration is verified.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; expected the one that `dexnudge sample --out` wrote")
    configurations = load_configurations(folder)
    scene, hand = read_problem(folder)
    scene.validate()
    if tuple(hand.joint_names) != configurations.joint_names:
        raise InputError(
            f"{folder}: the configurations have the joints {', '.join(configurations.joint_names)}, the hand in hand/ has "
            f"{', '.join(hand.joint_names)}; expected the same joints in the same order; sample again"
        )
    verified = np.flatnonzero(configurations.success)
    if len(verified) == 0:
        raise InputError(
            f"{folder}: none of the {len(configurations.q)} configurations is verified; expected at least one; sample "
            "again with --verified 1"
        )
    return VerifiedFolder(scene, hand, configurations, verified)
