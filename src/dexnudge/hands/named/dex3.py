"""Unitree's Dex3-1, right: two fingers and a thumb, 7 joints.

Description: the G1 humanoid with hands in `example-robot-data` (BSD-3), from Unitree's own; the hand is cut off at its palm.
Geometry: its visual meshes; the collision box of the thumb's second link is half as long as the link.
"""

from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import package_file
from dexnudge.hands.urdf import hand_from_urdf

CONFIG = HandConfig(
    name="dex3",
    palm="right_hand_palm_link",
    fingertips={
        "index": "right_hand_index_1_link",
        "middle": "right_hand_middle_1_link",
        "thumb": "right_hand_thumb_2_link",
    },
    palm_normal=(0.0, 1.0, 0.0),
    geometry="visual",
)


def dex3(*, base: bool = True) -> Hand:
    """Return the hand; HandError where the package example-robot-data is not installed."""
    path = package_file(
        "example-robot-data",
        "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf",
        what="hand 'dex3'",
        install="pip install 'dexnudge[hands]'",
    )
    return hand_from_urdf(path, CONFIG, base=base)
