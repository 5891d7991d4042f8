"""A description's tree made into a `Hand`."""

import heapq

import numpy as np

from dexnudge.errors import HandError, did_you_mean
from dexnudge.hands.arm_cut import renamed_world, without_arm, without_base
from dexnudge.hands.config import HandConfig, unit_direction
from dexnudge.hands.hand import Hand, Joint
from dexnudge.hands.joint_ranges import with_ranges
from dexnudge.hands.tree import Tree, TreeJoint, check_joints, check_sizes, rerooted


def hand_from_tree(tree: Tree, config: HandConfig, *, base: bool = True) -> Hand:
    """Return the hand with the palm as its root.

    Links keep the file's order as far as parents come before children; joints keep it strictly.

    Raises:
        HandError: a structure that is no tree, names that do not exist, or no joint to move.
    """
    tree, config = renamed_world(without_arm(tree, config), config)
    check_sizes(tree)
    tree = with_ranges(tree)
    check_joints(tree, config)
    notes = list(tree.notes)
    tree = rerooted(tree, config.palm)
    if not base and config.base_link is not None:
        tree = without_base(tree, config)
    carrier = {joint.child: joint for joint in tree.joints}
    links = _parents_first(tree, config.palm)
    independent = [joint for joint in tree.joints if not joint.fixed and joint.mimic is None]
    if not independent:
        raise HandError(
            f"hand '{tree.name}' cannot move: expected at least one revolute or prismatic joint, found none; "
            "mend the description"
        )
    if all(len(mesh.faces) == 0 for mesh in tree.links.values()):
        raise HandError(
            f"hand '{tree.name}' has no {config.geometry} geometry: expected it on at least one link, found none; "
            f"add <{config.geometry}> elements or set 'geometry' in the hand's YAML to the other kind"
        )
    names = [joint.name for joint in independent]
    fingertips = {digit: _solid_tip(tip, digit, tree, carrier, notes) for digit, tip in config.fingertips.items()}
    return Hand(
        name=config.name or tree.name,
        joint_names=tuple(names),
        lower=np.asarray([joint.lower for joint in independent]),
        upper=np.asarray([joint.upper for joint in independent]),
        link_names=tuple(links),
        link_parent=np.asarray([links.index(carrier[link].parent) if link in carrier else -1 for link in links]),
        joints=tuple(_hand_joint(carrier[link], names, tree) if link in carrier else None for link in links),
        link_meshes=tuple(tree.links[link] for link in links),
        fingertips=fingertips,
        couplings=config.couplings,
        palm_normal=np.zeros(3) if (facing := unit_direction(config.palm_normal)) is None else facing,
        base_link=config.base_link if config.base_link in links else None,
        notes=tuple(notes),
    )


def _solid_tip(tip: str, digit: str, tree: Tree, carrier: dict[str, TreeJoint], notes: list[str]) -> str:
    """Return the last link with geometry of a digit that ends in an empty one."""
    link = tip
    while not len(tree.links[link].faces) and link in carrier:
        link = carrier[link].parent
    if link != tip and link not in carrier:
        raise HandError(
            f"digit '{digit}' has no geometry: expected it on '{tip}' or a link between that and the palm, found none; "
            "add geometry or mend 'fingertips' in the hand's YAML"
        )
    if link != tip:
        notes.append(f"'{tip}' has no geometry: '{link}' counts as the tip of {digit}")
    return link


def _parents_first(tree: Tree, palm: str) -> list[str]:
    """Return the links in the file's order as far as parents come before children, the palm first."""
    rank = {link: number for number, link in enumerate(tree.links)}
    names, children = list(tree.links), {link: [] for link in tree.links}  # type: tuple[list[str], dict[str, list[int]]]
    for joint in tree.joints:
        children[joint.parent].append(rank[joint.child])
    order, waiting = [], [rank[palm]]
    while waiting:
        order.append(names[heapq.heappop(waiting)])
        for child in children[order[-1]]:
            heapq.heappush(waiting, child)
    return order


def _hand_joint(joint: TreeJoint, names: list[str], tree: Tree) -> Joint:
    if joint.fixed:
        return Joint(joint.name, joint.origin, joint.axis, None)
    by_name = {other.name: other for other in tree.joints}
    multiplier, offset, leader, seen = 1.0, 0.0, joint, {joint.name}
    while leader.mimic is not None:  # a leader may itself mimic another joint
        mimic = leader.mimic
        multiplier, offset = multiplier * mimic.multiplier, multiplier * mimic.offset + offset
        if mimic.leader not in by_name or by_name[mimic.leader].fixed or mimic.leader in seen:
            raise HandError(
                f"joint '{leader.name}' mimics '{mimic.leader}'{_meant(mimic.leader, names)}: expected one of {names}, or a "
                "joint that mimics one; mend the <mimic> element"
            )
        leader = by_name[mimic.leader]
        seen.add(leader.name)
    return Joint(joint.name, joint.origin, joint.axis, names.index(leader.name), multiplier, offset, joint.slides)


def _meant(name: str, names: list[str]) -> str:
    """Return a question for the joint that differs from `name` by a prefix or suffix, else for the one most like it."""
    longer = [other for other in names if other.endswith(name) or other.startswith(name) or name.endswith(other)]
    return f" (did you mean {longer[0]!r}?)" if len(longer) == 1 and longer[0] != name else did_you_mean(name, names)
