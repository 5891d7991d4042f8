"""Draws the named hands, opened, each with where its palm faces: docs/images/hands.png."""

from pathlib import Path

import dexnudge as dn
from dexnudge.hands.closing import closing
from dexnudge.viewer.hand_view import hand_views
from dexnudge.viewer.picture import arrange, render_array, write_png
from dexnudge.viewer.robot_pictures import hand_cameras

NAMED = ("shadow_lite", "shadow_full", "allegro", "leap", "dex3", "panda_gripper")
SIDE = "from the front"
TILE = (400, 440)  # pixels
ROOT = Path(__file__).parents[1]


def main() -> None:
    """Write the picture."""
    hands = {name: dn.load_hand(name) for name in NAMED}
    tiles = []
    for hand in hands.values():
        views = hand_views(hand, [closing(hand).open])
        tiles.append(render_array(views[0], size=TILE, camera=hand_cameras(views, TILE)[SIDE]))
    path = ROOT / "docs" / "images" / "hands.png"
    write_png(arrange(tiles, list(hands), columns=3), path)
    print(f"written: {path.relative_to(ROOT)}, {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
