"""Draws the named hands and a gripper, opened, each with where its palm faces: docs/images/hands.png."""

from pathlib import Path

import dexnudge as dn
from dexnudge.hands.closing import closing
from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import package_file
from dexnudge.hands.urdf import hand_from_urdf
from dexnudge.viewer.hand_picture import hand_cameras
from dexnudge.viewer.hand_view import hand_views
from dexnudge.viewer.picture import arrange, render_array, write_png

NAMED = ("shadow_lite", "shadow_full", "allegro", "leap", "dex3")
SIDE = "from the front"
TILE = (400, 440)  # pixels
ROOT = Path(__file__).parents[1]


def panda_gripper() -> Hand:
    """The gripper of Franka's Panda, whose jaws slide, in the description of the whole arm."""
    path = package_file(
        "example-robot-data",
        "panda_description/urdf/panda.urdf",
        hand="panda",
        install="pip install 'dexnudge[hands]'",
    )
    tips = {"left": "panda_leftfinger", "right": "panda_rightfinger"}
    return hand_from_urdf(path, HandConfig("panda_hand", tips, (0.0, 0.0, 1.0), geometry="visual"))


def main() -> None:
    """Write the picture."""
    hands = {name: dn.load_hand(name) for name in NAMED} | {"a gripper (Panda)": panda_gripper()}
    tiles = []
    for hand in hands.values():
        views = hand_views(hand, [closing(hand).open])
        tiles.append(render_array(views[0], size=TILE, camera=hand_cameras(views, TILE)[SIDE]))
    path = ROOT / "docs" / "images" / "hands.png"
    write_png(arrange(tiles, list(hands), columns=3), path)
    print(f"written: {path.relative_to(ROOT)}, {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
