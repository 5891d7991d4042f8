"""The arms that can be asked for by name."""

from collections.abc import Callable

from dexnudge.arms.arm import Arm
from dexnudge.arms.named.panda import panda
from dexnudge.arms.named.ur5 import ur5
from dexnudge.arms.named.ur5e import ur5e
from dexnudge.arms.named.xarm7 import xarm7

ARMS: dict[str, Callable[[], Arm]] = {"panda": panda, "ur5": ur5, "ur5e": ur5e, "xarm7": xarm7}
