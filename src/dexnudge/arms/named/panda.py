"""Franka's Panda: seven joints.

Kinematics and limits: Franka's published ones (Franka Control Interface, "Robot and interface specifications": modified
Denavit-Hartenberg parameters, limits in joint space). Geometry: the collision meshes in the `gymnasium-robotics` package.
"""

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.arms.arm import Arm, JointLimits
from dexnudge.hands.link_meshes import gymnasium_assets, load_link_mesh
from dexnudge.hands.tree import Tree, TreeJoint

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
