"""Universal Robots' UR5: six joints.

Kinematics, geometry, and limits of position, velocity and effort: ROS-Industrial's description in the package
`example-robot-data`.
"""

from dexnudge.arms.arm import Arm
from dexnudge.arms.config import ArmConfig
from dexnudge.arms.description import arm_from_package
from dexnudge.arms.named.ur5e import ACCELERATION, HOME, JERK

CONFIG = ArmConfig(name="ur5", flange="tool0", home=HOME, limits={"acceleration": ACCELERATION, "jerk": JERK})


def ur5() -> Arm:
    """Return the arm; ArmError where the package example-robot-data is not installed."""
    return arm_from_package("example-robot-data", "ur_description/urdf/ur5_robot.urdf", CONFIG)
