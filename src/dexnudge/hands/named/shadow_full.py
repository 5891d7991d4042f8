"""Shadow Dexterous Hand, right, all 24 joints, from the model in the `gymnasium-robotics` package.

Names are Shadow's (the package counts joints from zero: its FFJ3 is Shadow's FFJ4, its WRJ1 is WRJ2); axes, zero poses and
ranges are the package's, so THJ2 and THJ1 turn about y there and bend the thumb towards negative angles. The tree hangs
from the palm. With the base, the two wrist joints are part of q and move wrist and forearm behind the palm; without it,
wrist and forearm are left out and 22 joints remain. Geometry: the visual meshes, of the forearm its convex hull.
"""

import re
from dataclasses import replace

import mujoco

from dexnudge.hands.assembly import hand_from_tree
from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import gymnasium_assets
from dexnudge.hands.mjcf import tree_of_model
from dexnudge.hands.tree import Tree

PREFIX = "robot0:"
MOUNT = "hand mount"  # the package's empty body that places the hand in its own scenes
FINGERS = ("FF", "MF", "RF", "LF")
CONFIG = HandConfig(
    palm="palm",
    fingertips={digit: f"{digit.lower()}distal" for digit in (*FINGERS, "TH")},
    palm_normal=(0.0, -1.0, 0.0),
    couplings=tuple((f"{finger}J1", f"{finger}J2") for finger in FINGERS),
    base_link="forearm",
)


def shadow_full(*, base: bool = True) -> Hand:
    """Return the full hand: 24 joint angles with the base (wrist and forearm), 22 without.

    Raises:
        HandError: the package gymnasium-robotics is not installed.
    """
    model = compiled_model()
    names = [model.geom(geom).name.removeprefix(PREFIX) for geom in range(model.ngeom)]
    meshes = [bool(kind == mujoco.mjtGeom.mjGEOM_MESH) for kind in model.geom_type]

    def is_judged(geom: int) -> bool:
        return meshes[geom] and names[geom] != "V_forearm"

    tree = tree_of_model(model, "shadow_full", f"{PREFIX}palm", is_judged)
    return hand_from_tree(_shadow_names(tree), CONFIG, base=base)


def compiled_model() -> mujoco.MjModel:
    """Return the package's hand alone, without its scene; only the classes that `robot.xml` refers to are set."""
    assets = gymnasium_assets()
    classes = "".join(f'<default class="{PREFIX}{name}"/>' for name in ("asset_class", "DC_Hand", "D_Touch"))
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian" meshdir="{assets / "stls" / "hand"}"/>'
        f'<default>{classes}<default class="{PREFIX}D_Vizual"><geom type="mesh"/></default></default>'
        f'<asset><include file="{assets / "hand" / "shared_asset.xml"}"/></asset>'
        f'<worldbody><include file="{assets / "hand" / "robot.xml"}"/></worldbody></mujoco>'
    )


def _shadow_names(tree: Tree) -> Tree:
    def plain(link: str) -> str:
        return link.removeprefix(PREFIX)

    def counted_from_one(joint: str) -> str:
        return re.sub(r"J(\d)$", lambda match: f"J{int(match[1]) + 1}", plain(joint))

    tree = tree.renamed(plain).without({MOUNT})
    return replace(tree, joints=tuple(replace(joint, name=counted_from_one(joint.name)) for joint in tree.joints))
