"""Franka's hand for the Panda arm: two jaws that slide together by one joint.

Description: the Panda in `example-robot-data` (Apache 2.0), from Franka's own, with its collision meshes; without the arm.
"""

from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import package_file
from dexnudge.hands.urdf import hand_from_urdf

CONFIG = HandConfig(
    name="panda_gripper",
    palm="panda_hand",
    fingertips={"left": "panda_leftfinger", "right": "panda_rightfinger"},
    palm_normal=(0.0, 0.0, 1.0),
)


def panda_gripper(*, base: bool = True) -> Hand:
    """Return the gripper; HandError where the package example-robot-data is not installed."""
    path = package_file(
        "example-robot-data",
        "panda_description/urdf/panda.urdf",
        what="hand 'panda_gripper'",
        install="pip install 'dexnudge[hands]'",
    )
    return hand_from_urdf(path, CONFIG, base=base)
