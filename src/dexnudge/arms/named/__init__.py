"""The arms that can be asked for by name."""

from collections.abc import Callable

from dexnudge.arms.arm import Arm
from dexnudge.arms.named.panda import panda

ARMS: dict[str, Callable[[], Arm]] = {"panda": panda}
