"""Shadow Robot's hands: the Dexterous Hand, and its Lite version of three fingers and a thumb."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import trimesh

from dexnudge.hands.assembly import hand_from_tree
from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import Hand, Joint
from dexnudge.hands.link_meshes import gymnasium_assets, gymnasium_mesh
from dexnudge.hands.tree import Tree

KNUCKLES = {"FF": (0.033, 0.0, 0.095), "MF": (0.011, 0.0, 0.099), "RF": (-0.011, 0.0, 0.095)}  # [m] palm frame
ABDUCTION_AXES = {"FF": (0.0, -1.0, 0.0), "MF": (0.0, -1.0, 0.0), "RF": (0.0, 1.0, 0.0)}
FINGER_RANGES = {4: (-20.0, 20.0), 3: (-15.0, 90.0), 2: (0.0, 90.0), 1: (0.0, 90.0)}  # [deg]
THUMB_RANGES = {5: (-60.0, 60.0), 4: (0.0, 70.0), 2: (-40.0, 40.0), 1: (-15.0, 90.0)}  # [deg]
PROXIMAL_LENGTH, MIDDLE_LENGTH = 0.045, 0.025  # [m] along z
THUMB_PROXIMAL_LENGTH, THUMB_MIDDLE_LENGTH = 0.038, 0.032  # [m] along z
THUMB_ORIGIN, THUMB_RPY = (0.034, -0.00858, 0.029), (-45.0, 0.0, -90.0)  # [m], [deg]
BASE_EXTENTS, BASE_CENTRE = (0.120, 0.109, 0.130), (0.0, 0.0, 0.065)  # [m] in the base's own frame
PALM_IN_BASE, PALM_TILT = (0.0, -0.015, 0.149), -40.0  # [m], [deg] about x
DISTAL_MESH_OFFSET = (0.0, 0.0, 0.001)  # [m] as the package mounts it
THUMB_MESH_TURN = 90.0  # [deg] about z, from the package's thumb frames to Shadow's
X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
Vector = tuple[float, float, float]


def shadow_lite(*, base: bool = True) -> Hand:
    """Return the Lite, right: three fingers and a thumb, no little finger, no wrist.

    Kinematics: Shadow Robot's published description (`sr_common`, hand G). Link meshes: the Shadow Hand of the
    `gymnasium-robotics` package; its thumb meshes stand in frames turned by -90 degrees about z against Shadow's own.
    13 motors drive 16 joints, FFJ4..FFJ1, MFJ4..MFJ1, RFJ4..RFJ1, THJ5, THJ4, THJ2, THJ1: J1 and J2 of a finger share a
    tendon, which holds J1 <= J2. THJ3 is fixed at zero.

    Args:
        base: whether the forearm box behind the palm is part of the collision geometry.
    """
    joint_names: list[str] = []
    limits: list[tuple[float, float]] = []
    links: list[tuple[str, int, Joint | None, trimesh.Trimesh]] = [("palm", -1, None, gymnasium_mesh("palm"))]

    def add(
        link: str,
        parent: int,
        joint: str,
        origin: np.ndarray,
        axis: Vector,
        limit: tuple[float, float],
        mesh: trimesh.Trimesh,
    ) -> int:
        joint_names.append(joint)
        limits.append(limit)
        links.append(
            (link, parent, Joint(joint, origin, np.asarray(axis, dtype=np.float64), len(joint_names) - 1), mesh)
        )
        return len(links) - 1

    for finger, knuckle in KNUCKLES.items():
        names = [f"{finger}J{number}" for number in (4, 3, 2, 1)]
        low = finger.lower()
        ranges = [FINGER_RANGES[number] for number in (4, 3, 2, 1)]
        link = add(
            f"{low}knuckle", 0, names[0], _shift(knuckle), ABDUCTION_AXES[finger], ranges[0], gymnasium_mesh("knuckle")
        )
        link = add(f"{low}proximal", link, names[1], np.eye(4), X, ranges[1], gymnasium_mesh("F3"))
        link = add(
            f"{low}middle", link, names[2], _shift((0.0, 0.0, PROXIMAL_LENGTH)), X, ranges[2], gymnasium_mesh("F2")
        )
        distal = gymnasium_mesh("F1", _shift(DISTAL_MESH_OFFSET))
        add(f"{low}distal", link, names[3], _shift((0.0, 0.0, MIDDLE_LENGTH)), X, ranges[3], distal)

    turn = trimesh.transformations.rotation_matrix(np.radians(THUMB_MESH_TURN), Z)
    origin = _shift(THUMB_ORIGIN) @ trimesh.transformations.euler_matrix(*np.radians(THUMB_RPY), axes="sxyz")
    link = add("thbase", 0, "THJ5", origin, (0.0, 0.0, -1.0), THUMB_RANGES[5], trimesh.Trimesh())
    link = add("thproximal", link, "THJ4", np.eye(4), (0.0, 1.0, 0.0), THUMB_RANGES[4], gymnasium_mesh("TH3_z", turn))
    link = add(
        "thmiddle",
        link,
        "THJ2",
        _shift((0.0, 0.0, THUMB_PROXIMAL_LENGTH)),
        X,
        THUMB_RANGES[2],
        gymnasium_mesh("TH2_z", turn),
    )
    add(
        "thdistal",
        link,
        "THJ1",
        _shift((0.0, 0.0, THUMB_MIDDLE_LENGTH)),
        X,
        THUMB_RANGES[1],
        gymnasium_mesh("TH1_z", turn),
    )

    if base:
        T_base_palm = _shift(PALM_IN_BASE) @ trimesh.transformations.rotation_matrix(np.radians(PALM_TILT), X)
        box = trimesh.creation.box(BASE_EXTENTS, transform=_shift(BASE_CENTRE))
        links.append(("base", 0, Joint("base_mount", np.linalg.inv(T_base_palm), np.asarray(X), None), box))

    lower, upper = np.radians(np.asarray(limits, dtype=np.float64)).T
    return Hand(
        name="shadow_lite",
        joint_names=tuple(joint_names),
        lower=lower,
        upper=upper,
        link_names=tuple(name for name, *_ in links),
        link_parent=np.asarray([parent for _, parent, *_ in links]),
        joints=tuple(joint for *_, joint, _ in links),
        link_meshes=tuple(mesh for *_, mesh in links),
        fingertips={"FF": "ffdistal", "MF": "mfdistal", "RF": "rfdistal", "TH": "thdistal"},
        couplings=tuple((f"{finger}J1", f"{finger}J2") for finger in KNUCKLES),
        palm_normal=np.asarray((0.0, -1.0, 0.0)),
        base_link="base" if base else None,
    )


def _shift(translation: Vector) -> np.ndarray:
    return trimesh.transformations.translation_matrix(translation)


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
    """Return the Shadow Dexterous Hand, right, from the model in the `gymnasium-robotics` package.

    24 joint angles with the base (wrist and forearm), which then move behind the palm; 22 without.

    Names are Shadow's (the package counts joints from zero: its FFJ3 is Shadow's FFJ4, its WRJ1 is WRJ2); axes, zero poses
    and ranges are the package's, so THJ2 and THJ1 turn about y there and bend the thumb towards negative angles. The tree
    hangs from the palm. Geometry: the visual meshes, of the forearm its convex hull.

    Raises:
        HandError: the package gymnasium-robotics is not installed.
    """
    import mujoco  # which most commands can do without

    from dexnudge.hands.mjcf import tree_of_model

    model = compiled_model()
    names = [model.geom(geom).name.removeprefix(PREFIX) for geom in range(model.ngeom)]
    meshes = [bool(kind == mujoco.mjtGeom.mjGEOM_MESH) for kind in model.geom_type]

    def is_judged(geom: int) -> bool:
        return meshes[geom] and names[geom] != "V_forearm"

    tree = tree_of_model(model, "shadow_full", f"{PREFIX}palm", is_judged)
    return hand_from_tree(_shadow_names(tree), CONFIG, base=base)


def compiled_model() -> Any:
    """Return the package's hand alone, without its scene; only the classes that `robot.xml` refers to are set."""
    import mujoco

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
