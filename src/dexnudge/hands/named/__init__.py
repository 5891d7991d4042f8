"""The hands that can be asked for by name; their descriptions come from installed packages."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import package_file
from dexnudge.hands.named.leap import leap
from dexnudge.hands.named.shadow import shadow_full, shadow_lite
from dexnudge.hands.urdf import hand_from_urdf


@dataclass(frozen=True)
class PackagedHand:
    """A hand whose URDF, the file that ends in `file`, is in the package example-robot-data; what that does not say."""

    file: str
    config: HandConfig

    def __call__(self, *, base: bool = True) -> Hand:
        """Return the hand; HandError where the package is not installed."""
        path = package_file(
            "example-robot-data",
            self.file,
            what=f"hand '{self.config.name}'",
            install="pip install 'dexnudge[hands]'",
        )
        return replace(hand_from_urdf(path, self.config, base=base), shown_by=(path,))


# Wonik Robotics' Allegro Hand, right: three fingers and a thumb, 16 joints, all of them driven. Description (BSD) from
# Wonik's own. Geometry: its visual meshes; its collision boxes are up to 7 mm thicker than the links.
ALLEGRO = HandConfig(
    name="allegro",
    palm="palm_link",
    fingertips={"index": "link_3.0_tip", "middle": "link_7.0_tip", "ring": "link_11.0_tip", "thumb": "link_15.0_tip"},
    palm_normal=(1.0, 0.0, 0.0),
    geometry="visual",
)
# Unitree's Dex3-1, right: two fingers and a thumb, 7 joints. Description: the G1 humanoid with hands (BSD-3), from
# Unitree's own; the hand is cut off at its palm. Geometry: its visual meshes; the collision box of the thumb's second
# link is half as long as the link.
DEX3 = HandConfig(
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
# Franka's hand for the Panda arm: two jaws that slide together by one joint. Description (Apache 2.0) from Franka's own,
# with its collision meshes; without the arm.
PANDA_GRIPPER = HandConfig(
    name="panda_gripper",
    palm="panda_hand",
    fingertips={"left": "panda_leftfinger", "right": "panda_rightfinger"},
    palm_normal=(0.0, 0.0, 1.0),
)


HANDS: dict[str, Callable[..., Hand]] = {
    "allegro": PackagedHand("allegro_hand_description/urdf/allegro_right_hand.urdf", ALLEGRO),
    "dex3": PackagedHand("g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", DEX3),
    "leap": leap,
    "panda_gripper": PackagedHand("panda_description/urdf/panda.urdf", PANDA_GRIPPER),
    "shadow_full": shadow_full,
    "shadow_lite": shadow_lite,
}
