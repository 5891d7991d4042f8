"""An arm's kinematics as JSON: what inverse kinematics needs of it, every digit kept, and no geometry."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from dexnudge.arms.arm import Arm, JointLimits
from dexnudge.errors import ArmError, DexnudgeError, quote
from dexnudge.geometry.rigid import rigid_transform
from dexnudge.hands.tree import Mimic, Tree, TreeJoint, check_tree
from dexnudge.jobs.json_files import read_json_object

FIXED, TURNS, SLIDES = "fixed", "revolute", "prismatic"
KINDS: dict[str, tuple[type, str]] = {
    "arm": (str, "a name"),
    "joints": (list, "a list of joints"),
    "joint_names": (list, "a list of names"),
    "limits": (dict, "an object of lists of numbers"),
    "home": (list, "a list of numbers"),
    "flange": (str, "the name of a link"),
    "T_world_base": (list, "4 x 4 numbers"),
}
"""What each key of the file holds."""


def write_arm(arm: Arm, path: Path, **others: Any) -> None:
    """Write an arm and `others` beside it."""
    joints = [
        {
            "name": joint.name,
            "type": FIXED if joint.fixed else SLIDES if joint.slides else TURNS,
            "parent": joint.parent,
            "child": joint.child,
            "origin": joint.origin.tolist(),
            "axis": joint.axis.tolist(),
            "mimic": asdict(joint.mimic) if joint.mimic else None,
        }
        for joint in arm.tree.joints
    ]
    content = {
        "arm": arm.name,
        "joints": joints,
        "joint_names": list(arm.joint_names),
        "limits": {name: values.tolist() for name, values in asdict(arm.limits).items()},
        "home": arm.home.tolist(),
        "flange": arm.flange,
        "T_world_base": arm.T_world_base.tolist(),
        **{name: np.asarray(value).tolist() for name, value in others.items()},
    }
    path.write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")


def read_arm(path: Path) -> tuple[Arm, dict[str, Any]]:
    """Return the arm, its links without geometry, and all that the file holds.

    Raises:
        ArmError: the file is missing, damaged, or describes no arm.
    """
    try:
        content = read_json_object(path)
        return _arm(content), content
    except (
        KeyError,
        TypeError,
        ValueError,
        OverflowError,
        DexnudgeError,
    ) as error:  # a SceneError is a ValueError, too
        what = f"lacks the key {error}" if isinstance(error, KeyError) else str(error)
        raise ArmError(f"{path}: {what}; expected the arm that `dexnudge sample` wrote; sample again") from error


def _arm(content: dict[str, Any]) -> Arm:
    for key, (kind, expected) in KINDS.items():
        if type(content[key]) is not kind:
            raise ValueError(f"{key} is {quote(content[key])}; expected {expected}")
    names = tuple(map(str, content["joint_names"]))
    limits = JointLimits(**{name: _numbers(values, len(names)) for name, values in content["limits"].items()})
    joints = []
    for row in content["joints"]:
        kind, name = row["type"], str(row["name"])
        if kind not in (FIXED, TURNS, SLIDES):
            raise ValueError(f"joint '{name}' is of type {quote(kind)}; expected {FIXED}, {TURNS} or {SLIDES}")
        mimic = None
        if row["mimic"]:
            multiplier, offset = _numbers([row["mimic"]["multiplier"], row["mimic"]["offset"]], 2).tolist()
            mimic = Mimic(str(row["mimic"]["leader"]), multiplier, offset)
        moving = kind != FIXED and mimic is None
        index = names.index(name) if moving else 0
        joints.append(
            TreeJoint(
                name,
                str(row["parent"]),
                str(row["child"]),
                rigid_transform(row["origin"], f"the origin of joint '{name}'"),
                _numbers(row["axis"], 3),
                fixed=kind == FIXED,
                lower=float(limits.lower[index]) if moving else 0.0,
                upper=float(limits.upper[index]) if moving else 0.0,
                mimic=mimic,
                slides=kind == SLIDES,
            )
        )
    links = dict.fromkeys(link for joint in joints for link in (joint.parent, joint.child))
    tree = Tree(str(content["arm"]), {link: trimesh.Trimesh() for link in links}, tuple(joints))
    check_tree(tree)
    moving_names = {each.name for each in joints if not each.fixed and each.mimic is None}
    if content["flange"] not in links or moving_names != set(names):
        raise ValueError("its flange is none of its links, or its joints are not those of its tree")
    home = _numbers(content["home"], len(names))
    base = rigid_transform(content["T_world_base"], "T_world_base")
    return Arm(tree.name, tree, names, limits, home, str(content["flange"]), base)


def _numbers(values: Any, count: int) -> np.ndarray:
    """Return so many finite numbers; ValueError for anything else."""
    array = np.asarray(values, dtype=float)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ValueError(f"{quote(values)} is no list of {count} finite numbers")
    return array
