"""The hands that can be asked for by name, and the one way to load any hand."""

import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from dexnudge.errors import HandError, UnknownNameError, check_path, did_you_mean
from dexnudge.hands.config import LONGEST_QUOTE, HandConfig
from dexnudge.hands.hand import Hand
from dexnudge.hands.named import HANDS
from dexnudge.hands.tree import Tree
from dexnudge.hands.urdf import hand_from_urdf, urdf_tree
from dexnudge.plugins import call_plugin, plugin_names


def _hand_from_mjcf(path: Path, config: HandConfig | None, **options: Any) -> Hand:
    from dexnudge.hands.mjcf import hand_from_mjcf  # imports MuJoCo, which most commands can do without

    return hand_from_mjcf(path, config, **options)


def is_description(path: Path) -> bool:
    """Whether a path ends as descriptions do: .urdf, .xml, or .xacro."""
    return _suffix(path) in READERS


def _suffix(path: Path) -> str:
    return path.suffix.lower().replace(".xacro", ".urdf")  # whose reader expands it, or says how to


def check_packages(packages: object) -> None:
    """Raise HandError unless `packages` maps names to folders."""
    if packages is None:
        return
    valid = isinstance(packages, Mapping) and all(
        isinstance(name, str) and isinstance(folder, str | Path) for name, folder in packages.items()
    )
    if not valid:
        raise HandError(f"`packages` is {repr(packages)[:LONGEST_QUOTE]}; expected names of packages and their folders")


def read_hand(path: Path, config: HandConfig | None, **options: Any) -> Hand:
    """Return the hand of a description file, `config` in place of its YAML; `base` and `packages` as `load_hand`."""
    return replace(READERS[_suffix(path)](path, config, **options), source=path, shown_by=(path,))


def read_tree(path: Path, geometry: str, *, packages: Mapping[str, Path | str] | None = None) -> Tree:
    """Return the whole tree of a description with its "collision" or "visual" geometry; of a scene in MJCF the largest."""
    if _suffix(path) == ".xml":
        from dexnudge.hands.mjcf import mjcf_tree

        return mjcf_tree(path, geometry, packages)
    return urdf_tree(path, geometry, packages)


def read_robot_tree(
    path: Path,
    geometry: str,
    *,
    packages: Mapping[str, Path | str] | None = None,
    link: str | None = None,
    only: Collection[str] | None = None,
) -> Tree:
    """Return the whole tree, as `read_tree`, with what an arm needs: first joints and sites of an MJCF, efforts, a home.

    link: one of the tree that is meant, where a file holds several. only: links whose geometry is read; all unless given.
    """
    if _suffix(path) == ".xml":
        from dexnudge.hands.mjcf import mjcf_robot_tree

        return mjcf_robot_tree(path, geometry, packages or {}, link, only)
    return urdf_tree(path, geometry, packages, only=only)


PREPARED_NAME = "hand.urdf"  # the description in a prepared folder
READERS: dict[str, Callable[..., Hand]] = {".urdf": hand_from_urdf, ".xml": _hand_from_mjcf}


def load_hand(name_or_urdf: str | Path, *, base: bool = True, packages: Mapping[str, Path | str] | None = None) -> Hand:
    """Return the hand of that name, the one in a prepared folder, or that in a URDF or MJCF file with its YAML beside it.

    Args:
        name_or_urdf: name of a built-in hand, or of one that an installed package brings; a folder with a hand.urdf; or
            the path of a description (.urdf or .xml).
        base: whether the forearm or adapter behind the palm is part of the hand.
        packages: folders of the ROS packages that a description names, as in `package://NAME/meshes/palm.stl`; the package
            around the description is found without.

    Raises:
        UnknownNameError: neither a known name nor a path of a description.
        HandError: a description that cannot be used as given.
    """
    check_path("name_or_urdf", name_or_urdf, HandError)
    check_packages(packages)
    name = str(name_or_urdf)
    if name in HANDS:
        return HANDS[name](base=base)
    path = Path(name_or_urdf)
    if os.path.isfile(path / PREPARED_NAME):  # noqa: PTH113 - as below
        path /= PREPARED_NAME
    if is_description(path):
        return read_hand(path, None, base=base, packages=packages)
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
