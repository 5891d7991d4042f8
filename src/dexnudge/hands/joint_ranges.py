"""The ranges of a tree's independent joints: without stand-ins for "no limit", and within what every follower allows."""

from dataclasses import dataclass, replace

import numpy as np

from dexnudge.errors import HandError
from dexnudge.hands.tree import CONTINUOUS_LIMIT, Mimic, Tree, TreeJoint

ROUNDED = 1e-6  # [rad or m] by which printed limits may differ
SAID = 1e-3  # [rad or m] less of a range is said
NO_LIMIT = 1e3  # [rad] a limit from here on stands for none, as 1e16 does


@dataclass(frozen=True)
class Farthest:
    """How far from zero joints turn [rad] and slide [m]; what is more is in degrees or millimetres."""

    turn: float
    slide: float


OF_A_HAND = Farthest(turn=2 * np.pi + 0.1, slide=0.5)  # farther than any gripper opens


def with_ranges(tree: Tree, most: Farthest = OF_A_HAND) -> Tree:
    """Return the tree whose independent joints have ranges in which each follower keeps its own limits; see `notes`.

    most: how far joints go at all; beyond, numbers are in another unit.

    Raises:
        HandError: limits in another unit, or a follower that leaves its leader no range or goes too far.
    """
    notes: list[str] = []
    joints = {joint.name: _checked(joint, most, notes) for joint in tree.joints}
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
        _refuse_far(joints[name], joints[leader], multiplier, offset, most)
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


def _checked(joint: TreeJoint, most: Farthest, notes: list[str]) -> TreeJoint:
    """Return a joint without stand-ins for "no limit"; refuse limits in another unit."""
    free = joint.mimic is not None
    if joint.fixed or (free and np.isinf([joint.lower, joint.upper]).all()):
        return joint
    farthest = max(abs(joint.lower), abs(joint.upper))
    if not joint.slides and farthest >= NO_LIMIT:
        notes.append(
            f"joint '{joint.name}': limits of {joint.lower:.3g} to {joint.upper:.3g} rad stand for none: it turns freely"
        )
        end = np.inf if free else CONTINUOUS_LIMIT
        return replace(joint, lower=-end, upper=end, endless=True)
    if not joint.slides and farthest > most.turn:
        raise HandError(
            f"joint '{joint.name}': expected limits in radians, got {joint.lower:g} to {joint.upper:g}, that is up to "
            f"{np.degrees(farthest):.0f} degrees; in degrees? write {np.radians(joint.lower):.4f} to "
            f"{np.radians(joint.upper):.4f}"
        )
    if joint.slides and not free and not np.isfinite(farthest):
        raise HandError(
            f"joint '{joint.name}' slides without limits: expected a least and a greatest value [m], found none; add them"
        )
    if joint.slides and not free and farthest > most.slide:
        raise HandError(
            f"joint '{joint.name}': expected limits in metres, at most {most.slide:g} from zero, got "
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
        with np.errstate(over="ignore"):
            others = offset - multiplier * np.array([leader.lower, leader.upper])
        mirrored = others.min() >= follower.lower - SAID and others.max() <= follower.upper + SAID
        raise HandError(
            f"joint '{follower.name}' follows '{leader.name}' as {multiplier:g} x + {offset:g} and leaves it no range: "
            f"expected values within its own limits, {follower.lower:g} to {follower.upper:g}, while '{leader.name}' goes "
            f"from {leader.lower:g} to {leader.upper:g}; mend multiplier, offset or limits"
            f"{f': a multiplier of {-multiplier:g} keeps them' if mirrored else ''}"
        )
    return replace(leader, lower=low, upper=high)


def _refuse_far(follower: TreeJoint, leader: TreeJoint, multiplier: float, offset: float, most: Farthest) -> None:
    """Refuse a follower that goes farther than a joint does: its multiplier or offset is in another unit."""
    with np.errstate(over="ignore", invalid="ignore"):
        ends = multiplier * np.array([leader.lower, leader.upper]) + offset
    farthest, unit = (most.slide, "m") if follower.slides else (most.turn, "rad")
    if not (np.abs(ends) <= farthest).all():
        raise HandError(
            f"joint '{follower.name}' follows '{leader.name}' as {multiplier:g} x + {offset:g}: expected at most "
            f"{farthest:.3g} {unit} from zero, got {ends.min():g} to {ends.max():g}; mend multiplier, offset or its limits"
        )
