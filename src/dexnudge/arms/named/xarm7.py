"""UFACTORY's xArm 7: seven joints.

Kinematics, geometry, and limits of position, velocity and effort: the maker's description in the package
`example-robot-data`.
"""

from dexnudge.arms.arm import Arm
from dexnudge.arms.config import ArmConfig
from dexnudge.arms.description import arm_from_package

# Acceleration and jerk: half of what the maker's manual allows, 1145 deg/s^2 and 28647 deg/s^3.
CONFIG = ArmConfig(
    name="xarm7",
    flange="link_eef",
    home=[0.0, 0.0, 0.0, 1.07, 0.0, 1.07, 0.0],
    limits={"acceleration": 10.0, "jerk": 250.0},
)


def xarm7() -> Arm:
    """Return the arm; ArmError where the package example-robot-data is not installed."""
    return arm_from_package("example-robot-data", "xarm_description/urdf/xarm7.urdf", CONFIG)
