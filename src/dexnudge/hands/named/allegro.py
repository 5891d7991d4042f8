"""Wonik Robotics' Allegro Hand, right: three fingers and a thumb, 16 joints, all of them driven.

Description: `example-robot-data` (BSD), from Wonik's own. Geometry: its visual meshes; its collision boxes are up to 7 mm
thicker than the links.
"""

from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import package_file
from dexnudge.hands.urdf import hand_from_urdf

CONFIG = HandConfig(
    name="allegro",
    palm="palm_link",
    fingertips={"index": "link_3.0_tip", "middle": "link_7.0_tip", "ring": "link_11.0_tip", "thumb": "link_15.0_tip"},
    palm_normal=(1.0, 0.0, 0.0),
    geometry="visual",
)


def allegro(*, base: bool = True) -> Hand:
    """Return the hand; HandError where the package example-robot-data is not installed."""
    path = package_file(
        "example-robot-data",
        "allegro_hand_description/urdf/allegro_right_hand.urdf",
        what="hand 'allegro'",
        install="pip install 'dexnudge[hands]'",
    )
    return hand_from_urdf(path, CONFIG, base=base)
