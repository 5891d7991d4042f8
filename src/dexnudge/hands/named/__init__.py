"""The hands that can be asked for by name, one short file each; their descriptions come from installed packages."""

from collections.abc import Callable

from dexnudge.hands.hand import Hand
from dexnudge.hands.named.allegro import allegro
from dexnudge.hands.named.dex3 import dex3
from dexnudge.hands.named.leap import leap
from dexnudge.hands.named.panda_gripper import panda_gripper
from dexnudge.hands.named.shadow_lite import shadow_lite


def _shadow_full(*, base: bool) -> Hand:
    from dexnudge.hands.named.shadow_full import shadow_full  # imports MuJoCo, which most commands can do without

    return shadow_full(base=base)


HANDS: dict[str, Callable[..., Hand]] = {
    "allegro": allegro,
    "dex3": dex3,
    "leap": leap,
    "panda_gripper": panda_gripper,
    "shadow_full": _shadow_full,
    "shadow_lite": shadow_lite,
}
