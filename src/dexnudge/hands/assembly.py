"""A description's tree made into a `Hand`: without an arm, joints that place it in the world and, on request, the base."""

import heapq
from dataclasses import replace

import numpy as np

from dexnudge.errors import HandError, did_you_mean
from dexnudge.finding import length_text
from dexnudge.hands.config import HandConfig, unit_direction
from dexnudge.hands.hand import Hand, Joint
from dexnudge.hands.joint_ranges import with_ranges
from dexnudge.hands.tree import Tree, TreeJoint, check_joints, check_names, check_sizes, check_tree, locked, rerooted


def hand_from_tree(tree: Tree, config: HandConfig, *, base: bool = True) -> Hand:
    """Return the hand with the palm as its root.

    Links keep the file's order as far as parents come before children; joints keep it strictly.

    Raises:
        HandError: a structure that is no tree, names that do not exist, or no joint to move.
    """
    tree, config = renamed_world(without_arm(tree, config), config)
    check_sizes(tree)
    tree = with_ranges(_without_idle_joints(tree, config))
    check_joints(tree, config)
    notes = list(tree.notes)
    tree = rerooted(tree, config.palm)
    if not base and config.base_link is not None:
        tree = without_base(tree, config)
    carrier, links = tree.carrier, _parents_first(tree)
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
    fingertips = {digit: _solid_tip(tip, digit, tree, notes) for digit, tip in config.fingertips.items()}
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


SPECK = 0.003  # [m] a link of at most that size stands for none: simulators want something on every link


def _without_idle_joints(tree: Tree, config: HandConfig) -> Tree:
    """Return the tree with the joints fixed that move no geometry and lead none that does, as motors may; see `notes`."""
    solid = [link for link, mesh in tree.links.items() if len(mesh.faces) and mesh.extents.max() > SPECK]
    moved = {each for link in (*solid, config.palm) for each in (link, *tree.links_above(link))}
    joints = {joint.name: joint for joint in tree.joints if not (joint.fixed or joint.places)}
    coupled = {name for pair in config.couplings for name in pair}
    used = [name for name, joint in joints.items() if joint.child in moved or name in coupled]
    for name in used:
        mimic = joints[name].mimic
        if mimic is not None and mimic.leader in joints and mimic.leader not in used:
            used.append(mimic.leader)
    idle = [name for name in joints if name not in used]
    if not idle or not solid:
        return tree

    def still(joint: TreeJoint) -> TreeJoint:
        return locked(joint, float(np.clip(0.0, joint.lower, joint.upper)))

    note = f"joints that move no geometry above {length_text(SPECK)} and lead no other were left out: {', '.join(idle)}"
    kept = tuple(still(joint) if joint.name in idle else joint for joint in tree.joints)
    return replace(tree, joints=kept, notes=(*tree.notes, note))


def _solid_tip(tip: str, digit: str, tree: Tree, notes: list[str]) -> str:
    """Return the last link with geometry of a digit that ends in an empty one."""
    chain = [tip, *tree.links_above(tip)]
    link = next((each for each in chain if len(tree.links[each].faces)), chain[-1])
    if link != tip and link == tree.root:
        raise HandError(
            f"digit '{digit}' has no geometry: expected it on '{tip}' or a link between that and the palm, found none; "
            "add geometry or mend 'fingertips' in the hand's YAML"
        )
    if link != tip:
        notes.append(f"'{tip}' has no geometry: '{link}' counts as the tip of {digit}")
    return link


def _parents_first(tree: Tree) -> list[str]:
    """Return the links in the file's order as far as parents come before children."""
    names, rank = list(tree.links), {link: number for number, link in enumerate(tree.links)}
    order: list[str] = []
    waiting = [rank[tree.root]]
    while waiting:
        order.append(names[heapq.heappop(waiting)])
        for joint in tree.hanging.get(order[-1], ()):
            heapq.heappush(waiting, rank[joint.child])
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
    mounts, named = tree.hanging.get(WORLD, []), {config.palm, config.base_link, *config.fingertips.values()}
    if tree.root != WORLD or WORLD in named or len(tree.links[WORLD].faces):
        return tree
    return tree.below(mounts[0].child) if len(mounts) == 1 and mounts[0].fixed else tree


def renamed_world(tree: Tree, config: HandConfig) -> tuple[Tree, HandConfig]:
    """Return tree and facts with another name for a link called "world", which is MuJoCo's own; see `notes`."""
    if WORLD not in tree.links:
        return tree, config
    name = f"{WORLD}_link"
    while name in tree.links:
        name += "_"

    def new(link: str) -> str:
        return name if link == WORLD else link

    config = replace(
        config,
        palm=new(config.palm),
        fingertips={digit: new(link) for digit, link in config.fingertips.items()},
        base_link=None if config.base_link is None else new(config.base_link),
    )
    note = f"link '{WORLD}' is called '{name}' here: MuJoCo keeps that name for what does not move"
    return replace(tree.renamed(new), notes=(*tree.notes, note)), config


def _without_placing_joints(tree: Tree, config: HandConfig, notes: list[str]) -> Tree:
    """Return the tree without the empty links at its root, if a joint among them does not turn: it places the hand.

    The root of q places the hand.
    """
    link = tree.root
    cut: list[TreeJoint] = []
    while link not in (config.palm, config.base_link) and not len(tree.links[link].faces):
        if len(hanging := tree.hanging.get(link, [])) != 1:
            break
        cut += hanging
        link = hanging[0].child
    if not any(joint.slides or joint.places for joint in cut):
        return tree
    moving = ", ".join(joint.name for joint in cut if not joint.fixed)
    notes.append(f"joints that place the hand in the world were cut off: {moving}")
    return tree.below(link)


def _without_long_chain(tree: Tree, config: HandConfig, notes: list[str]) -> Tree:
    """Return the tree below `base_link`, or below the palm where more joints than a wrist has lie above it.

    What is cut off is an arm, or a whole robot with its other arm.
    """
    place = _place(tree, config)
    above = reversed(tree.chain_to(place))
    cut = [joint.name for joint in above if not (joint.fixed or joint.slides or joint.places)]
    if len(cut) <= (0 if place != config.palm else WRIST_JOINTS):
        return tree
    kept = tree.below(place)
    notes.append(
        f"an arm of {len(cut)} joints, {cut[-1]} to {cut[0]}, was cut off above '{place}' with "
        f"{len(tree.links) - len(kept.links)} links; "
        "'base_link' in the hand's YAML names the last link behind the palm that stays"
    )
    return kept


def _without_slides_above(tree: Tree, config: HandConfig, notes: list[str]) -> Tree:
    """Return the tree below the last joint that slides above palm and fingertips, such as a gantry's or a lift's."""
    for joint in reversed(tree.chain_to(_place(tree, config))):
        kept = tree.below(joint.child)
        if (joint.slides or joint.places) and set(config.fingertips.values()) <= set(kept.links):
            notes.append(
                f"'{joint.name}', which moves '{joint.child}' along, was cut off with "
                f"{len(tree.links) - len(kept.links)} links"
            )
            return kept
    return tree


def without_base(tree: Tree, config: HandConfig) -> Tree:
    """Return the tree without the links on the base's side of the palm that lead to no fingertip."""
    assert config.base_link is not None
    if config.base_link == config.palm:
        return tree
    kept = {link for tip in config.fingertips.values() for link in (tip, *tree.links_above(tip))}
    return tree.without(tree.below(tree.chain_to(config.base_link)[0].child).links.keys() - kept)


def _place(tree: Tree, config: HandConfig) -> str:
    """Return the link at which the hand hangs in the world: the base where the palm hangs from it, else the palm."""
    return config.base_link if config.base_link in (config.palm, *tree.links_above(config.palm)) else config.palm
