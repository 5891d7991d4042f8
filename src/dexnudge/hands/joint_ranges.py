"""The ranges of a tree's independent joints: without stand-ins for "no limit", and within what every follower allows."""

from dataclasses import replace

import numpy as np

from dexnudge.errors import HandError
from dexnudge.hands.tree import CONTINUOUS_LIMIT, Mimic, Tree, TreeJoint

NO_LIMIT = 1e3  # [rad] a limit from here on stands for none, as 1e16 does
LARGEST_LIMIT = 2 * np.pi + 0.1  # [rad] no joint of a hand turns farther: the number is in degrees
LONGEST_SLIDE = 0.5  # [m] from zero; farther than any gripper opens
ROUNDED = 1e-6  # [rad or m] by which printed limits may differ
SAID = 1e-3  # [rad or m] less of a range is said


def with_ranges(tree: Tree) -> Tree:
    """Return the tree whose independent joints have ranges in which each follower keeps its own limits; see `notes`.

    Raises:
        HandError: limits in another unit, or a follower that leaves its leader no range or goes too far.
    """
    notes: list[str] = []
    joints = {joint.name: _checked(joint, notes) for joint in tree.joints}
    stated = dict(joints)
    followers = {name: line for name in joints if (line := line_of(joints, name)) is not None}
    for name, (leader, multiplier, offset) in followers.items():
        joints[leader] = _narrowed(joints[leader], joints[name], multiplier, offset)
    for leader, joint in joints.items():
        if joint.lower - stated[leader].lower > SAID or stated[leader].upper - joint.upper > SAID:
            names = ", ".join(name for name, line in followers.items() if line[0] == leader)
            notes.append(
                f"joint '{leader}' ranges from {joint.lower:.4g} to {joint.upper:.4g}, not {stated[leader].lower:.4g} to "
                f"{stated[leader].upper:.4g}: its followers keep their own limits ({names})"
            )
    direct = sorted(followers, key=lambda name: joints[name].mimic != Mimic(*followers[name]))
    for name in direct:  # before those that follow followers
        leader, multiplier, offset = followers[name]
        _refuse_far(joints[name], joints[leader], multiplier, offset)
    return replace(tree, joints=tuple(joints[joint.name] for joint in tree.joints), notes=(*tree.notes, *notes))


def line_of(joints: dict[str, TreeJoint], name: str) -> tuple[str, float, float] | None:
    """Return the independent joint that a joint follows, with multiplier and offset.

    None where the joint is independent itself or its leaders lead nowhere.
    """
    multiplier, offset, leader, seen = 1.0, 0.0, joints[name], {name}
    while leader.mimic is not None:  # a leader may itself follow another joint
        mimic = leader.mimic
        multiplier, offset = multiplier * mimic.multiplier, multiplier * mimic.offset + offset
        if mimic.leader not in joints or joints[mimic.leader].fixed or mimic.leader in seen:
            return None
        leader = joints[mimic.leader]
        seen.add(leader.name)
    return None if leader.name == name or leader.fixed else (leader.name, multiplier, offset)


def _checked(joint: TreeJoint, notes: list[str]) -> TreeJoint:
    """Return a joint without stand-ins for "no limit"; refuse limits in another unit."""
    free = joint.mimic is not None
    if joint.fixed or (free and np.isinf([joint.lower, joint.upper]).all()):
        return joint
    farthest = max(abs(joint.lower), abs(joint.upper))
    if not joint.slides and farthest >= NO_LIMIT:
        notes.append(
            f"joint '{joint.name}': limits of {joint.lower:.3g} to {joint.upper:.3g} rad stand for none: it turns freely"
        )
        most = np.inf if free else CONTINUOUS_LIMIT
        return replace(joint, lower=-most, upper=most)
    if not joint.slides and farthest > LARGEST_LIMIT:
        raise HandError(
            f"joint '{joint.name}': expected limits in radians, got {joint.lower:g} to {joint.upper:g}, that is up to "
            f"{np.degrees(farthest):.0f} degrees; in degrees? write {np.radians(joint.lower):.4f} to "
            f"{np.radians(joint.upper):.4f}"
        )
    if joint.slides and not free and not np.isfinite(farthest):
        raise HandError(
            f"joint '{joint.name}' slides without limits: expected a least and a greatest value [m], found none; add them"
        )
    if joint.slides and not free and farthest > LONGEST_SLIDE:
        raise HandError(
            f"joint '{joint.name}': expected limits in metres, at most {LONGEST_SLIDE:g} from zero, got "
            f"{joint.lower:g} to {joint.upper:g}; in millimetres? write {joint.lower / 1e3:g} to {joint.upper / 1e3:g}"
        )
    return joint


def _narrowed(leader: TreeJoint, follower: TreeJoint, multiplier: float, offset: float) -> TreeJoint:
    """Return the leader with the part of its range in which a follower keeps its own limits."""
    if follower.lower == follower.upper:  # as where a file states efforts alone
        return leader
    low, high = leader.lower, leader.upper
    with np.errstate(over="ignore"):
        if multiplier:
            ends = np.sort((np.array([follower.lower, follower.upper]) - offset) / np.float64(multiplier))
            low = max(low, float(ends[0])) if ends[0] - low > ROUNDED else low
            high = min(high, float(ends[1])) if high - ends[1] > ROUNDED else high
    keeps = multiplier or follower.lower - ROUNDED <= offset <= follower.upper + ROUNDED
    if not keeps or low > high or (high - low < ROUNDED < leader.upper - leader.lower):
        raise HandError(
            f"joint '{follower.name}' follows '{leader.name}' as {multiplier:g} x + {offset:g} and leaves it no range: "
            f"expected values within its own limits, {follower.lower:g} to {follower.upper:g}, while '{leader.name}' goes "
            f"from {leader.lower:g} to {leader.upper:g}; mend multiplier, offset or limits"
        )
    return replace(leader, lower=low, upper=high)


def _refuse_far(follower: TreeJoint, leader: TreeJoint, multiplier: float, offset: float) -> None:
    """Refuse a follower that goes farther than a joint of a hand does: its multiplier or offset is in another unit."""
    with np.errstate(over="ignore", invalid="ignore"):
        ends = multiplier * np.array([leader.lower, leader.upper]) + offset
    most, unit = (LONGEST_SLIDE, "m") if follower.slides else (LARGEST_LIMIT, "rad")
    if not (np.abs(ends) <= most).all():
        raise HandError(
            f"joint '{follower.name}' follows '{leader.name}' as {multiplier:g} x + {offset:g}: expected at most "
            f"{most:.3g} {unit} from zero, got {ends.min():g} to {ends.max():g}; mend multiplier, offset or its limits"
        )
