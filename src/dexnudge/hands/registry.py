"""The hands that can be asked for by name, and the one way to load any hand."""

import os
from collections.abc import Callable
from pathlib import Path

from dexnudge.errors import HandError, UnknownNameError, check_path, did_you_mean
from dexnudge.hands.hand import Hand
from dexnudge.hands.named import HANDS
from dexnudge.hands.urdf import hand_from_urdf
from dexnudge.plugins import call_plugin, plugin_names


def _hand_from_mjcf(path: Path, *, base: bool) -> Hand:
    from dexnudge.hands.mjcf import hand_from_mjcf  # imports MuJoCo, which most commands can do without

    return hand_from_mjcf(path, base=base)


READERS: dict[str, Callable[..., Hand]] = {".urdf": hand_from_urdf, ".xml": _hand_from_mjcf}


def load_hand(name_or_urdf: str | Path, *, base: bool = True) -> Hand:
    """Return the hand of that name, or the one in a URDF (.urdf) or MJCF (.xml) file with its YAML beside it.

    Args:
        name_or_urdf: name of a built-in hand, or of one that an installed package brings, or the path of a description.
        base: whether the forearm or adapter behind the palm is part of the hand.

    Raises:
        UnknownNameError: neither a known name nor a path of a description.
        HandError: a description that cannot be used as given.
    """
    check_path("name_or_urdf", name_or_urdf, HandError)
    name = str(name_or_urdf)
    if name in HANDS:
        return HANDS[name](base=base)
    path = Path(name_or_urdf)
    suffix = path.suffix.lower().replace(".xacro", ".urdf")  # whose reader says how to expand it
    if suffix in READERS:
        return READERS[suffix](path, base=base)
    if os.path.exists(path):  # noqa: PTH110 - a name of 300 letters does not exist, which is no error
        raise HandError(
            f"{path}: expected a description that ends in {' or '.join(READERS)}, got '{path.suffix}'; mend the path"
        )
    brought = plugin_names("hand")
    if name in brought:
        return call_plugin("hand", name, Hand, base=base)
    names = [*sorted(HANDS), *brought]
    raise UnknownNameError(
        f"unknown hand '{name}'{did_you_mean(name, names)}: expected one of {', '.join(names)}, "
        f"or the path of a {' or '.join(READERS)} file; mend the name"
    )
