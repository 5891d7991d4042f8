"""The robot of a plan, read back from the folder that `export_robot` wrote, and whether a plan.json is of this robot."""

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float

from dexnudge.arms.arm import Arm
from dexnudge.arms.description import OF_AN_ARM
from dexnudge.arms.export import HAND_FOLDER, STAND, URDF, WORLD
from dexnudge.arms.robot import Robot
from dexnudge.errors import InputError, quote
from dexnudge.hands.hand import Hand, Joint
from dexnudge.hands.registry import load_hand
from dexnudge.hands.tree import Mimic, Tree, TreeJoint, check_sizes
from dexnudge.hands.urdf import numbers_of, urdf_tree
from dexnudge.hands.xml_text import read_xml
from dexnudge.trajectories.plan import JointTrajectory, Phase
from dexnudge.trajectories.plan_json import LIMITS, motors_of, units_of
from dexnudge.trajectories.plan_reader import AGAIN, BEYOND, MOST_SHARE, PlanFile, joint_limits

SAME_PLACE = 1e-6  # [m], and of rotations' entries: frames that two files state


def read_robot(folder: Path, content: PlanFile, plan: Path) -> Robot:
    """Return arm and hand.

    Args:
        folder: with robot.urdf and hand/.
        content: of plan.json, whose accelerations and jerks no URDF states.
        plan: the path of plan.json, for messages.

    Raises:
        InputError: a file is missing or damaged, or they do not belong together.
    """
    path = folder / URDF
    hand = load_hand(folder / HAND_FOLDER)
    mount = hand.base_link or hand.link_names[0]
    if mount != content.mount:
        raise InputError(
            f"{plan}: mount is '{content.mount}'; expected '{mount}', by which the hand in {folder / HAND_FOLDER} is "
            f"held; {AGAIN}"
        )
    tree = urdf_tree(path, "collision")
    check_sizes(tree, OF_AN_ARM.slide)
    arm = _arm(tree, hand, content, path)
    robot = Robot(arm, hand, content.T_flange_mount)
    if (["rad"] * len(robot.joint_names) if content.units is None else content.units) != units_of(robot):
        raise InputError(
            f"{plan}: units is {quote(content.units)}; expected {units_of(robot)}, one a joint, as they turn or "
            f"slide; {AGAIN}"
        )
    _check_motors(content.actuators, robot, plan)
    _check_links(robot, {joint.child: joint for joint in tree.joints}, path, plan)
    return robot


def _arm(tree: Tree, hand: Hand, content: PlanFile, path: Path) -> Arm:
    """Return the links of the URDF that are not the hand's, with the limits that it and the plan state."""
    links = {name: mesh for name, mesh in tree.links.items() if name not in (WORLD, *hand.link_names)}
    if content.flange not in links:
        raise InputError(f"{path} has no link '{content.flange}' beside the hand's; expected the arm's flange; {AGAIN}")
    joints = tuple(joint for joint in tree.joints if joint.child in links and joint.parent in links)
    moving = tuple(joint for joint in joints if not joint.fixed and joint.mimic is None)
    if len(content.home) != len(moving):
        raise InputError(
            f"{path.parent}: the arm has {len(moving)} joints, home {len(content.home)} numbers; expected a number a "
            f"joint; {AGAIN}"
        )
    for joint, angle in zip(moving, content.home.tolist(), strict=True):
        if not joint.lower - BEYOND <= angle <= joint.upper + BEYOND:
            raise InputError(
                f"{path.parent}: home of '{joint.name}' is {angle:g}; expected it within its limits {joint.lower:g} to "
                f"{joint.upper:g}; {AGAIN}"
            )
    stated = _stated_limits(path)

    def of_urdf(key: str) -> Float[np.ndarray, " n"]:
        rows = [numbers_of(stated[joint.name], key, (0.0,), f"{path}: joint '{joint.name}'") for joint in moving]
        return np.array(rows, dtype=float).reshape(-1)

    own = {joint.name: content.limits[joint.name] for joint in moving}
    return Arm(
        name=content.arm,
        tree=Tree(content.arm, links, joints),
        joint_names=tuple(joint.name for joint in moving),
        limits=replace(
            joint_limits(own, of_urdf("effort")),
            lower=np.array([joint.lower for joint in moving]),
            upper=np.array([joint.upper for joint in moving]),
            velocity=of_urdf("velocity"),
        ),
        home=content.home,
        flange=content.flange,
        T_world_base=content.T_world_base,
    )


def _check_motors(given: Any, robot: Robot, plan: Path) -> None:
    """Raise InputError unless a plan's actuators are those that drive the robot."""
    expected = motors_of(robot)
    if not isinstance(given, list) or len(given) != len(expected):
        raise InputError(
            f"{plan}: actuators is {quote(given)}; expected the {len(expected)} motors of arm and hand; {AGAIN}"
        )
    for index, (found, motor) in enumerate(zip(given, expected, strict=True)):
        for key, value in motor.items():
            got = found.get(key) if isinstance(found, dict) else found
            if not (_close(got, value) if isinstance(value, float) else got == value):
                raise InputError(
                    f"{plan}: actuators[{index}]: {key} is {quote(got)}; expected {value}, of the motor "
                    f"'{motor['name']}'; it follows from the robot's joints and efforts; {AGAIN}"
                )


def _close(found: Any, expected: float) -> bool:
    return type(found) in (int, float) and math.isclose(found, expected, rel_tol=BEYOND)


def _check_links(robot: Robot, carrier: dict[str, TreeJoint], path: Path, plan: Path) -> None:
    """Raise InputError unless each link of the robot hangs in the URDF as in plan.json and hand/."""
    body, limits = robot.body, robot.limits
    base = Joint(STAND, robot.arm.T_world_base, np.array([0.0, 0.0, 1.0]), None)
    if len(carrier) != len(body.link_names):
        raise InputError(
            f"{path} has {len(carrier)} joints; expected {len(body.link_names)}, one for each link of arm and hand; {AGAIN}"
        )
    for link, name in enumerate(body.link_names):
        joint = body.joints[link] or base
        parent = body.link_names[body.link_parent[link]] if link else WORLD
        mimic, ends = None, (0.0, 0.0)
        if joint.index is not None:
            ends = (float(limits.lower[joint.index]), float(limits.upper[joint.index]))
            if joint.name != body.joint_names[joint.index]:
                mimic = Mimic(body.joint_names[joint.index], joint.multiplier, joint.offset)
        expected = TreeJoint(
            joint.name, parent, name, joint.origin, joint.axis, joint.index is None, *ends, mimic=mimic
        )
        found = carrier.get(name)
        if found is None or not _same(found, replace(expected, slides=joint.slides)):
            raise InputError(
                f"{path}: link '{name}' hangs otherwise than {plan.name} and {HAND_FOLDER}/ say; expected it on '{parent}' "
                f"by the joint '{joint.name}' at {np.round(joint.origin[:3, 3], 4).tolist()} m; are the files of one plan? "
                f"{AGAIN}"
            )


def _same(found: TreeJoint, expected: TreeJoint) -> bool:
    """Whether two joints move the same link the same way, within the same limits where they lead."""
    names = ("parent", "child", "fixed", "slides", *(() if found.fixed else ("name",)))
    if any(getattr(found, name) != getattr(expected, name) for name in names):
        return False
    if not np.allclose(found.origin, expected.origin, rtol=0.0, atol=SAME_PLACE):
        return False
    if found.fixed:
        return True
    if (found.mimic is None) != (expected.mimic is None):
        return False
    if found.mimic is not None and expected.mimic is not None:
        one, other = vars(found.mimic), vars(expected.mimic)
        return (
            one["leader"] == other["leader"]
            and np.allclose(found.axis, expected.axis)
            and math.isclose(one["multiplier"], other["multiplier"], rel_tol=SAME_PLACE)
            and math.isclose(one["offset"], other["offset"], abs_tol=SAME_PLACE)
        )
    pairs = zip((*found.axis, found.lower, found.upper), (*expected.axis, expected.lower, expected.upper), strict=True)
    return all(math.isclose(one, other, abs_tol=SAME_PLACE) for one, other in pairs)


def check_links(phases: tuple[Phase, ...], links: tuple[str, ...], path: Path) -> None:
    """Refuse a force of a link that the hand has not; InputError."""
    for phase in phases:
        unknown = [name for name in phase.link_force if name not in links]
        if unknown:
            raise InputError(
                f"{path}: link_force of phase '{phase.name}' names {quote(unknown[0])}; expected links of the hand: "
                f"{', '.join(links)}"
            )


def check_effort(trajectory: JointTrajectory, robot: Robot, path: Path) -> None:
    """Refuse what the robot's motors cannot add; InputError."""
    most = robot.limits.effort * MOST_SHARE
    beyond = np.argwhere(np.abs(trajectory.effort) > most)
    if len(beyond):
        sample, joint = beyond[0]
        raise InputError(
            f"{path}: effort of '{robot.joint_names[joint]}' at {trajectory.time[sample]:g} s is "
            f"{trajectory.effort[sample, joint]:g}; expected at most {robot.limits.effort[joint]:g}, its motor's limit; "
            f"{AGAIN}"
        )


def check_joints(names: tuple[str, ...], folder: Path, path: Path) -> None:
    """Refuse a plan whose joints are not those of robot.urdf in `folder`, in their order; InputError."""
    file = folder / URDF
    if not file.is_file():
        raise InputError(
            f"{file} is missing; expected the robot of {path} beside it; give the whole folder that Plan.save or "
            "`dexnudge plan` wrote; a plan.json of its own is for controllers only"
        )
    joints = read_xml(file, root_tag="robot").findall("joint")
    expected = [str(each.get("name")) for each in joints if each.get("type") != "fixed" and each.find("mimic") is None]
    if list(names) == expected:
        return
    missing = list((Counter(expected) - Counter(names)).elements())
    unknown = list((Counter(names) - Counter(expected)).elements())
    if missing or unknown:
        parts = [f"lacks {', '.join(missing)}"] if missing else []
        parts += [f"has {', '.join(unknown)}, which {file.name} has not"] if unknown else []
        what, hint = " and ".join(parts), "is it a plan of another arm or hand?"
    else:
        place = next(index for index, pair in enumerate(zip(names, expected, strict=True)) if pair[0] != pair[1])
        what = f"has other joints first: '{names[place]}' stands where {file.name} has '{expected[place]}'"
        hint = "were the joints reordered?"
    raise InputError(f"{path}: joint_names {what}; expected the joints of {file} in their order; {hint} {AGAIN}")


def compare_limits(given: dict[str, Float[np.ndarray, " 5"]], folder: Path, path: Path) -> None:
    """Refuse limits that are not those of robot.urdf in `folder`, as far as a URDF states them; InputError."""
    file = folder / URDF
    stated = _stated_limits(file)
    for name, row in given.items():
        for kind, value in list(zip(LIMITS, row.tolist(), strict=True))[:3]:
            expected = float(numbers_of(stated[name], kind, (0.0,), f"{file}: joint '{name}'")[0])
            if not math.isclose(value, expected, rel_tol=BEYOND, abs_tol=BEYOND):
                raise InputError(
                    f"{path}: limits of '{name}': {kind} is {value:g}; expected {expected:g}, as {file.name} has it; is it "
                    f"a plan of another arm or hand? {AGAIN}"
                )


def _stated_limits(file: Path) -> dict[str, Element | None]:
    """Return the element of a URDF that states each joint's limits."""
    return {str(joint.get("name")): joint.find("limit") for joint in read_xml(file, root_tag="robot").iter("joint")}
