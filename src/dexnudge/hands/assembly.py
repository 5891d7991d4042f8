"""A description's tree made into a `Hand`: without an arm, joints that place it in the world and, on request, the base."""

import heapq
from dataclasses import replace

import numpy as np

from dexnudge.errors import HandError, did_you_mean
from dexnudge.hands.config import HandConfig, unit_direction
from dexnudge.hands.hand import Hand, Joint
from dexnudge.hands.joint_ranges import with_ranges
from dexnudge.hands.tree import (
    Tree,
    TreeJoint,
    chain_to,
    check_joints,
    check_names,
    check_sizes,
    check_tree,
    joints_below,
    rerooted,
)


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


WORLD = "world"  # MuJoCo's name for what does not move
WRIST_JOINTS = 3  # above the palm; more are an arm's


def without_arm(tree: Tree, config: HandConfig) -> Tree:
    """Return what hangs in the world as a hand, without an arm and other joints that place it; see `notes`.

    Raises:
        HandError: a structure that is no tree, or names that do not exist.
    """
    check_tree(tree)
    check_names(tree, config)
    notes: list[str] = []
    cut = _without_placing_joints(tree, config, notes)
    cut = _without_slides_above(_without_long_chain(cut, config, notes), config, notes)
    return replace(_without_empty_world(cut, config), notes=(*tree.notes, *notes))


def _without_empty_world(tree: Tree, config: HandConfig) -> Tree:
    """Return the tree without an empty root called "world" to which the hand is fixed."""
    mounts = [joint for joint in tree.joints if joint.parent == WORLD]
    named = {config.palm, config.base_link, *config.fingertips.values()}
    root = WORLD in tree.links and WORLD not in named and all(joint.child != WORLD for joint in tree.joints)
    if not root or len(mounts) != 1 or not mounts[0].fixed or len(tree.links[WORLD].faces):
        return tree
    return below(tree, mounts[0].child)


def renamed_world(tree: Tree, config: HandConfig) -> tuple[Tree, HandConfig]:
    """Return tree and facts with another name for a link called "world", which is MuJoCo's own; see `notes`."""
    if WORLD not in tree.links:
        return tree, config
    name = f"{WORLD}_link"
    while name in tree.links:
        name += "_"
    new = {link: name if link == WORLD else link for link in tree.links}
    joints = tuple(replace(joint, parent=new[joint.parent], child=new[joint.child]) for joint in tree.joints)
    config = replace(
        config,
        palm=new[config.palm],
        fingertips={digit: new[link] for digit, link in config.fingertips.items()},
        base_link=None if config.base_link is None else new[config.base_link],
    )
    note = f"link '{WORLD}' is called '{name}' here: MuJoCo keeps that name for what does not move"
    links = {new[link]: mesh for link, mesh in tree.links.items()}
    return replace(tree, links=links, joints=joints, notes=(*tree.notes, note)), config


def _without_placing_joints(tree: Tree, config: HandConfig, notes: list[str]) -> Tree:
    """Return the tree without the empty links at its root, if a joint among them does not turn: it places the hand.

    The root of q places the hand.
    """
    hanging: dict[str, list[TreeJoint]] = {link: [] for link in tree.links}
    for joint in tree.joints:
        hanging[joint.parent].append(joint)
    link = next(iter(set(tree.links) - {joint.child for joint in tree.joints}))
    cut: list[TreeJoint] = []
    while len(hanging[link]) == 1 and not len(tree.links[link].faces) and link not in (config.palm, config.base_link):
        cut += hanging[link]
        link = hanging[link][0].child
    if any(joint.slides or joint.places for joint in cut):
        moving = ", ".join(joint.name for joint in cut if not joint.fixed)
        notes.append(f"joints that place the hand in the world were cut off: {moving}")
        gone = {joint.parent for joint in cut}
        links = {name: mesh for name, mesh in tree.links.items() if name not in gone}
        tree = replace(tree, links=links, joints=tuple(joint for joint in tree.joints if joint not in cut))
    return tree


def _without_long_chain(tree: Tree, config: HandConfig, notes: list[str]) -> Tree:
    """Return the tree below `base_link`, or below the palm where more joints than a wrist has lie above it.

    What is cut off is an arm, or a whole robot with its other arm.
    """
    place = _place(tree, config)
    above = reversed(chain_to(tree, place))
    cut = [joint.name for joint in above if not (joint.fixed or joint.slides or joint.places)]
    if len(cut) <= (0 if place != config.palm else WRIST_JOINTS):
        return tree
    kept = below(tree, place)
    notes.append(
        f"an arm of {len(cut)} joints, {cut[-1]} to {cut[0]}, was cut off above '{place}' with "
        f"{len(tree.links) - len(kept.links)} links; "
        "'base_link' in the hand's YAML names the last link behind the palm that stays"
    )
    return kept


def _without_slides_above(tree: Tree, config: HandConfig, notes: list[str]) -> Tree:
    """Return the tree below the last joint that slides above palm and fingertips, such as a gantry's or a lift's."""
    for joint in reversed(chain_to(tree, _place(tree, config))):
        kept = below(tree, joint.child)
        if (joint.slides or joint.places) and set(config.fingertips.values()) <= set(kept.links):
            notes.append(
                f"'{joint.name}', which moves '{joint.child}' along, was cut off with "
                f"{len(tree.links) - len(kept.links)} links"
            )
            return kept
    return tree


def without_base(tree: Tree, config: HandConfig) -> Tree:
    """Return the tree without the links on the base's side of the palm that lead to no fingertip."""
    parent = {joint.child: joint.parent for joint in tree.joints}

    def above(link: str) -> list[str]:
        chain = [link]
        while chain[-1] in parent:
            chain.append(parent[chain[-1]])
        return chain

    assert config.base_link is not None
    if config.base_link == config.palm:
        return tree
    arm = above(config.base_link)[-2]
    kept = {link for tip in config.fingertips.values() for link in above(tip)}
    gone = {link for link in tree.links if arm in above(link) and link not in kept}
    links = {name: mesh for name, mesh in tree.links.items() if name not in gone}
    return replace(tree, links=links, joints=tuple(joint for joint in tree.joints if joint.child not in gone))


def _place(tree: Tree, config: HandConfig) -> str:
    """Return the link at which the hand hangs in the world: the base where the palm hangs from it, else the palm."""
    if config.base_link is not None and config.palm in below(tree, config.base_link).links:
        return config.base_link
    return config.palm


def below(tree: Tree, link: str) -> Tree:
    """Return the tree of a link and all links below it."""
    kept = {link, *(joint.child for joint in joints_below(tree, link))}
    links = {name: mesh for name, mesh in tree.links.items() if name in kept}
    return replace(tree, links=links, joints=tuple(joint for joint in tree.joints if joint.parent in kept))
