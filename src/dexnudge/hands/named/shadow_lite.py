"""Shadow Dexterous Hand Lite, right: three fingers and a thumb, no little finger, no wrist.

Kinematics: Shadow Robot's published description of the Lite (`sr_common`, hand G). Link meshes: the Shadow Hand of the
`gymnasium-robotics` package; its thumb meshes stand in frames turned by -90 degrees about z against Shadow's own.
13 motors drive 16 joints: J1 and J2 of a finger share a tendon, which holds J1 <= J2. THJ3 is fixed at zero.
"""

import numpy as np
import trimesh

from dexnudge.hands.hand import Hand, Joint
from dexnudge.hands.link_meshes import gymnasium_mesh

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
    """Return the Lite with 16 joint angles FFJ4..FFJ1, MFJ4..MFJ1, RFJ4..RFJ1, THJ5, THJ4, THJ2, THJ1.

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
