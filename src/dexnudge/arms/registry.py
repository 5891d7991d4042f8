"""The one way to load any arm: by name, or from a description."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dexnudge.arms.arm import Arm
from dexnudge.arms.description import arm_from_description
from dexnudge.arms.named import ARMS
from dexnudge.errors import ArmError, HandError, UnknownNameError, check_path, did_you_mean
from dexnudge.hands.registry import check_packages, is_description
from dexnudge.plugins import call_plugin, plugin_names


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
