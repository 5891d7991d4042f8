"""A hand's kinematic tree as a description file states it, checked, given the palm as its root, and made into a `Hand`."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from dexnudge.errors import HandError
from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import Hand, Joint

MAX_LINKS = 1000  # of a hand, or an arm and a hand
WRIST_JOINTS = 3  # above the palm; more are an arm's
LONGEST_LINK = 2.0  # [m] a forearm or a stand; longer is in another unit
LONGEST_SLIDE = 0.5  # [m] from zero; farther than any gripper opens
FLATTEST_LINK = 1e-9  # volume of the hull / longest side cubed


@dataclass(frozen=True)
class Mimic:
    """angle = multiplier * angle(leader) + offset."""

    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class TreeJoint:
    """T_parent_child = origin @ rotation(axis, angle), or `origin` alone where the joint is fixed.

    Of a joint that `slides` it is origin @ translation(axis * value). `places`: type of any other joint, which may only
    place the hand in the world.
    """

    name: str
    parent: str
    child: str
    origin: Float[np.ndarray, "4 4"]
    axis: Float[np.ndarray, " 3"]
    fixed: bool
    lower: float = 0.0
    upper: float = 0.0
    mimic: Mimic | None = None
    slides: bool = False
    places: str | None = None


@dataclass(frozen=True)
class Tree:
    """Links with their geometry (in the link frame [m], possibly empty) and joints, both in the file's order."""

    name: str
    links: dict[str, trimesh.Trimesh]
    joints: tuple[TreeJoint, ...]


def hand_from_tree(tree: Tree, config: HandConfig, *, base: bool = True) -> Hand:
    """Return the hand with the palm as its root.

    Links keep the file's order as far as parents come before children; joints keep it strictly.

    Raises:
        HandError: a structure that is no tree, names that do not exist, or no joint to move.
    """
    check_tree(tree)
    _check_names(tree, config)
    notes: list[str] = []
    tree = _without_placing_joints(tree, config, notes)
    tree = _without_arm(tree, config, notes)
    tree = _without_slides_above(tree, config, notes)
    _check_sizes(tree)
    _check_joints(tree, config)
    tree = rerooted(tree, config.palm)
    if not base and config.base_link is not None:
        tree = _without_base(tree, config)
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
        palm_normal=np.asarray(config.palm_normal) / np.linalg.norm(config.palm_normal),
        base_link=config.base_link if config.base_link in links else None,
        notes=tuple(notes),
    )


def check_tree(tree: Tree) -> None:
    """Raise HandError unless every link but one has exactly one parent and hangs below that one."""
    parent_joint: dict[str, TreeJoint] = {}
    for joint in tree.joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in tree.links:
                raise HandError(
                    f"joint '{joint.name}' names an unknown {role} link '{link}'; "
                    f"expected one of {list(tree.links)}; mend the name or add the link"
                )
        if joint.child in parent_joint:
            raise HandError(
                f"kinematic loop: expected one joint above each link, got '{parent_joint[joint.child].name}' and "
                f"'{joint.name}' above link '{joint.child}'; cut the loop (closed chains are not supported)"
            )
        parent_joint[joint.child] = joint
    roots = [link for link in tree.links if link not in parent_joint]
    if len(roots) > 1:
        raise HandError(f"expected one root link, got {roots}; connect them with joints or remove the loose ones")
    for start in tree.links:
        link, seen = start, {start}
        while link in parent_joint:
            link = parent_joint[link].parent
            if link in seen:
                raise HandError(
                    f"kinematic loop: expected a tree, got link '{link}' below itself; "
                    "cut the loop (closed chains are not supported)"
                )
            seen.add(link)


def _without_arm(tree: Tree, config: HandConfig, notes: list[str]) -> Tree:
    """Return the tree below `base_link`, or below the palm where more joints than a wrist has lie above it.

    What is cut off is an arm, or a whole robot with its other arm.
    """
    carrier = {joint.child: joint for joint in tree.joints}

    def movable_above(link: str) -> list[str]:
        names = []
        while link in carrier:
            turns = not (carrier[link].fixed or carrier[link].slides or carrier[link].places)
            names += [carrier[link].name] if turns else []
            link = carrier[link].parent
        return names

    place = _place(tree, config)
    cut = movable_above(place)
    if len(cut) <= (0 if place != config.palm else WRIST_JOINTS):
        return tree
    kept = _below(tree, place)
    notes.append(
        f"an arm of {len(cut)} joints, {cut[-1]} to {cut[0]}, was cut off above '{place}' with "
        f"{len(tree.links) - len(kept.links)} links; "
        "'base_link' in the hand's YAML names the last link behind the palm that stays"
    )
    return kept


def _place(tree: Tree, config: HandConfig) -> str:
    """Return the link at which the hand hangs in the world: the base where the palm hangs from it, else the palm."""
    if config.base_link is not None and config.palm in _descendants(tree, config.base_link):
        return config.base_link
    return config.palm


def _below(tree: Tree, link: str) -> Tree:
    """Return the tree of a link and all links below it."""
    kept = _descendants(tree, link)
    links = {name: mesh for name, mesh in tree.links.items() if name in kept}
    return Tree(tree.name, links, tuple(joint for joint in tree.joints if joint.parent in kept))


def _descendants(tree: Tree, link: str) -> set[str]:
    """Return a link and all links below it."""
    children: dict[str, list[str]] = {}
    for joint in tree.joints:
        children.setdefault(joint.parent, []).append(joint.child)
    found, waiting = set(), [link]
    while waiting:
        found.add(waiting[-1])
        waiting += children.get(waiting.pop(), [])
    return found


def _without_placing_joints(tree: Tree, config: HandConfig, notes: list[str]) -> Tree:
    """Return the tree without the empty links at its root, if a joint among them does not turn: it places the hand.

    The root of q places the hand.
    """
    below: dict[str, list[TreeJoint]] = {link: [] for link in tree.links}
    for joint in tree.joints:
        below[joint.parent].append(joint)
    link = next(iter(set(tree.links) - {joint.child for joint in tree.joints}))
    cut: list[TreeJoint] = []
    while len(below[link]) == 1 and not len(tree.links[link].faces) and link not in (config.palm, config.base_link):
        cut += below[link]
        link = below[link][0].child
    if any(joint.slides or joint.places for joint in cut):
        moving = ", ".join(joint.name for joint in cut if not joint.fixed)
        notes.append(f"joints that place the hand in the world were cut off: {moving}")
        gone = {joint.parent for joint in cut}
        links = {name: mesh for name, mesh in tree.links.items() if name not in gone}
        tree = Tree(tree.name, links, tuple(joint for joint in tree.joints if joint not in cut))
    return tree


def _without_slides_above(tree: Tree, config: HandConfig, notes: list[str]) -> Tree:
    """Return the tree below the last joint that slides above palm and fingertips, such as a gantry's or a lift's."""
    carrier = {joint.child: joint for joint in tree.joints}
    link = _place(tree, config)
    while link in carrier:
        joint = carrier[link]
        kept = _below(tree, link)
        if (joint.slides or joint.places) and set(config.fingertips.values()) <= set(kept.links):
            notes.append(
                f"'{joint.name}', which moves '{link}' along, was cut off with {len(tree.links) - len(kept.links)} links"
            )
            return kept
        link = joint.parent
    return tree


def _check_joints(tree: Tree, config: HandConfig) -> None:
    """Refuse joints that neither turn nor slide, and slides without an end or as long as in another unit."""
    for joint in tree.joints:
        if joint.places is not None:
            raise HandError(
                f"joint '{joint.name}': expected type revolute, continuous, prismatic, fixed, got '{joint.places}'; "
                "replace the joint or fix it"
            )
        if not joint.slides or joint.mimic is not None:
            continue
        farthest = max(abs(joint.lower), abs(joint.upper))
        if not np.isfinite(farthest):
            raise HandError(
                f"joint '{joint.name}' slides without limits: expected a least and a greatest value [m], found none; "
                "add them"
            )
        if farthest > LONGEST_SLIDE:
            raise HandError(
                f"joint '{joint.name}': expected limits in metres, at most {LONGEST_SLIDE:g} from zero, got "
                f"{joint.lower:g} to {joint.upper:g}; in millimetres? write {joint.lower / 1e3:g} to {joint.upper / 1e3:g}"
            )
    slides = {joint.name: joint.slides for joint in tree.joints}
    for follower, leader in config.couplings:
        if slides[follower] != slides[leader]:
            raise HandError(
                f"coupling {follower} <= {leader} compares a slide with an angle: expected joints of one kind; mend the pair"
            )


def _check_sizes(tree: Tree) -> None:
    """Refuse links that are too long for a hand or too far from each other, or flat."""
    for joint in tree.joints:
        distance = float(np.linalg.norm(joint.origin[:3, 3]))
        if distance > LONGEST_LINK:
            raise HandError(
                f"joint '{joint.name}' lies {distance:.3g} m from the frame of '{joint.parent}': expected at most "
                f"{LONGEST_LINK:g} m; in millimetres? give its origin in metres"
            )
    for link, mesh in tree.links.items():
        if not len(mesh.faces):
            continue
        longest = float(mesh.extents.max())
        if longest > LONGEST_LINK:
            raise HandError(
                f"link '{link}' is {longest:.3g} m long: expected at most {LONGEST_LINK:g} m; in millimetres? "
                'give its mesh scale="0.001 0.001 0.001", or a basic shape its size in metres'
            )
        try:
            volume = ConvexHull(mesh.vertices / longest).volume
        except QhullError:
            volume = 0.0
        if volume < FLATTEST_LINK:
            raise HandError(
                f"the geometry of link '{link}' is flat: expected a body with a thickness, which physics needs; "
                "give it one, or replace it by a thin box"
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


def rerooted(tree: Tree, palm: str) -> Tree:
    """Return the same tree hanging from `palm`.

    A joint on the way from the old root, T_parent_child = O R(a, t), is turned round: the former child carries the former
    parent by R(-a, t). For that the former parent's frame moves by O, and its geometry and other joints by O^-1; the
    frames of links between the old root and the palm therefore differ from the file's.
    """
    carrier = {joint.child: joint for joint in tree.joints}
    shift: dict[str, np.ndarray] = {}  # T_old_new of the links whose frames move
    reversed_joints: set[str] = set()
    link = palm
    while link in carrier:
        joint = carrier[link]
        shift[joint.parent] = joint.origin
        reversed_joints.add(joint.name)
        link = joint.parent
    if not shift:
        return tree
    joints = []
    for joint in tree.joints:
        if joint.name in reversed_joints:
            origin = np.linalg.inv(shift.get(joint.child, np.eye(4)))
            joints.append(replace(joint, parent=joint.child, child=joint.parent, origin=origin, axis=-joint.axis))
        else:
            origin = np.linalg.inv(shift.get(joint.parent, np.eye(4))) @ joint.origin
            joints.append(replace(joint, origin=origin))
    links = {}
    for name, mesh in tree.links.items():
        links[name] = mesh
        if name in shift and len(mesh.faces):
            links[name] = mesh.copy()
            links[name].apply_transform(np.linalg.inv(shift[name]))
    return Tree(tree.name, links, tuple(joints))


def _check_names(tree: Tree, config: HandConfig) -> None:
    named = {"palm": config.palm, "base_link": config.base_link}
    named |= {f"fingertips.{digit}": link for digit, link in config.fingertips.items()}
    for key, link in named.items():
        if link is not None and link not in tree.links:
            raise HandError(
                f"the hand's YAML names an unknown link: key '{key}': "
                f"expected one of {list(tree.links)}, got '{link}'; mend it"
            )
    movable = [joint.name for joint in tree.joints if not joint.fixed and joint.mimic is None]
    for follower, leader in config.couplings:
        for name in (follower, leader):
            if name not in movable:
                raise HandError(
                    "the hand's YAML couples an unknown joint: key 'couplings': "
                    f"expected some of {movable}, got '{name}'; mend it"
                )
        limits = {joint.name: joint for joint in tree.joints}
        if limits[follower].lower > limits[leader].upper:
            raise HandError(
                f"coupling {follower} <= {leader} cannot hold: expected {follower}'s lower limit at most {leader}'s upper, "
                f"got {limits[follower].lower} and {limits[leader].upper} rad; swap the pair or mend the limits"
            )


def _without_base(tree: Tree, config: HandConfig) -> Tree:
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
    return Tree(tree.name, links, tuple(joint for joint in tree.joints if joint.child not in gone))


def _parents_first(tree: Tree, palm: str) -> list[str]:
    parent = {joint.child: joint.parent for joint in tree.joints}
    placed, waiting = {palm: None}, [link for link in tree.links if link != palm]
    while waiting:
        following = next(link for link in waiting if parent[link] in placed)
        placed[following] = None
        waiting.remove(following)
    return list(placed)


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
                f"joint '{leader.name}' mimics '{mimic.leader}': expected one of {names}, or a joint that mimics one; "
                "mend the <mimic> element"
            )
        leader = by_name[mimic.leader]
        seen.add(leader.name)
    return Joint(joint.name, joint.origin, joint.axis, names.index(leader.name), multiplier, offset, joint.slides)
