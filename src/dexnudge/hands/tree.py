"""A hand's kinematic tree as a description file states it: links and joints, checked, and given another root."""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import LONGEST_NAME, HandError, is_name, quote
from dexnudge.geometry.meshes import is_flat
from dexnudge.hands.config import HandConfig

MAX_LINKS = 1000  # of a hand, or an arm and a hand
CONTINUOUS_LIMIT = np.pi  # [rad] either way: a joint without limits still needs a finite range to sample from
MAX_JOINTS = 100  # of a hand, that move; two Shadow hands with their arms have 62
MAX_SHAPES = 3000  # of all links together; a sphere has 1,280 triangles


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
    place the hand in the world. `endless`: `lower` and `upper` stand in for limits that it does not have. `velocity`
    [rad/s], `effort` [N m]: its limits; None where the file states none.
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
    endless: bool = False
    velocity: float | None = None
    effort: float | None = None


@dataclass(frozen=True)
class Tree:
    """Links with their geometry (in the link frame [m], possibly empty) and joints, both in the file's order.

    home: joint angles of the pose that the file calls so, by joint [rad].
    """

    name: str
    links: dict[str, trimesh.Trimesh]
    joints: tuple[TreeJoint, ...]
    notes: tuple[str, ...] = ()
    home: dict[str, float] = field(default_factory=dict)

    @cached_property
    def carrier(self) -> dict[str, TreeJoint]:
        """Of each link but the root, the joint that carries it."""
        return {joint.child: joint for joint in self.joints}

    @cached_property
    def hanging(self) -> dict[str, list[TreeJoint]]:
        """Of each link that is no end, the joints that hang from it."""
        found: dict[str, list[TreeJoint]] = {}
        for joint in self.joints:
            found.setdefault(joint.parent, []).append(joint)
        return found

    @property
    def root(self) -> str:
        """The link that no joint carries."""
        return next(link for link in self.links if link not in self.carrier)

    def chain_to(self, link: str) -> list[TreeJoint]:
        """Return the joints from the root to a link, fixed ones among them."""
        found = []
        while link in self.carrier:
            found.append(self.carrier[link])
            link = found[-1].parent
        return found[::-1]

    def links_above(self, link: str) -> list[str]:
        """Return the links from a link's parent to the root."""
        return [joint.parent for joint in reversed(self.chain_to(link))]

    def joints_below(self, link: str) -> list[TreeJoint]:
        """Return the joints below a link, parents first."""
        found = list(self.hanging.get(link, ()))
        for joint in found:
            found += self.hanging.get(joint.child, ())
        return found

    def below(self, link: str) -> "Tree":
        """Return the tree of a link and all links below it."""
        return self.without(self.links.keys() - {link, *(joint.child for joint in self.joints_below(link))})

    def without(self, gone: Collection[str]) -> "Tree":
        """Return the tree without some links, and without the joints on either side of them."""
        links = {name: mesh for name, mesh in self.links.items() if name not in gone}
        joints = tuple(joint for joint in self.joints if joint.parent not in gone and joint.child not in gone)
        return replace(self, links=links, joints=joints)

    def renamed(self, new: Callable[[str], str]) -> "Tree":
        """Return the tree with each link called as `new` says."""
        joints = tuple(replace(joint, parent=new(joint.parent), child=new(joint.child)) for joint in self.joints)
        return replace(self, links={new(link): mesh for link, mesh in self.links.items()}, joints=joints)


def locked(joint: TreeJoint, value: float) -> TreeJoint:
    """Return a joint fixed where it stands at `value` [rad or m]."""
    if joint.slides:
        motion = trimesh.transformations.translation_matrix(value * joint.axis)
    else:
        motion = trimesh.transformations.rotation_matrix(value, joint.axis)
    return replace(joint, origin=joint.origin @ motion, fixed=True, mimic=None, slides=False)


def check_tree(tree: Tree) -> None:
    """Raise HandError unless every link but one has exactly one parent and hangs below that one."""
    for name in (tree.name, *tree.links, *(joint.name for joint in tree.joints)):
        if not is_name(name):
            raise HandError(f"the name {quote(name)}: expected at most {LONGEST_NAME} printable characters; rename it")
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


def rerooted(tree: Tree, palm: str) -> Tree:
    """Return the same tree hanging from `palm`.

    A joint on the way from the old root, T_parent_child = O R(a, t), is turned round: the former child carries the former
    parent by R(-a, t). For that the former parent's frame moves by O, and its geometry and other joints by O^-1; the
    frames of links between the old root and the palm therefore differ from the file's.
    """
    above = tree.chain_to(palm)
    shift = {joint.parent: joint.origin for joint in above}  # T_old_new of the links whose frames move
    reversed_joints = {joint.name for joint in above}
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
    return replace(tree, links=links, joints=tuple(joints))


LONGEST_LINK = 2.0  # [m] a forearm or a stand; longer is in another unit


def check_names(tree: Tree, config: HandConfig) -> None:
    """Refuse a YAML that names links or joints that do not exist, or couples joints that cannot be."""
    named = {"palm": config.palm, "base_link": config.base_link}
    named |= {f"fingertips.{digit}": link for digit, link in config.fingertips.items()}
    for key, link in named.items():
        if link is not None and link not in tree.links:
            raise HandError(
                f"the hand's YAML names an unknown link: key '{key}': "
                f"expected one of {list(tree.links)}, got '{link}'; mend it"
            )
    for digit, link in config.fingertips.items():
        chain = [link, *tree.links_above(link)]
        if config.palm in chain and config.base_link in chain[: chain.index(config.palm)]:
            raise HandError(
                f"the hand's YAML names '{config.base_link}' as 'base_link', which is part of digit '{digit}': expected a "
                "link behind the palm; mend it"
            )
    movable = [joint.name for joint in tree.joints if not joint.fixed and joint.mimic is None]
    for follower, leader in config.couplings:
        for name in (follower, leader):
            if name not in movable:
                raise HandError(
                    "the hand's YAML couples an unknown joint: key 'couplings': "
                    f"expected some of {movable}, got '{name}'; mend it"
                )
        if follower == leader or (leader, follower) in config.couplings:
            raise HandError(
                f"coupling {follower} <= {leader} holds a joint to itself: expected pairs [follower, leader] without a "
                "circle; remove one"
            )
        limits = {joint.name: joint for joint in tree.joints}
        if limits[follower].lower > limits[leader].upper:
            raise HandError(
                f"coupling {follower} <= {leader} cannot hold: expected {follower}'s lower limit at most {leader}'s upper, "
                f"got {limits[follower].lower} and {limits[leader].upper} rad; swap the pair or mend the limits"
            )


def check_sizes(tree: Tree, longest_link: float = LONGEST_LINK) -> None:
    """Refuse links that are too long [m], too far from each other, too large for points all over them, or flat."""
    largest = longest_link**2 / 2  # [m^2]
    for joint in tree.joints:
        distance = math.hypot(*joint.origin[:3, 3])
        if distance > longest_link:
            raise HandError(
                f"joint '{joint.name}' lies {distance:.3g} m from the frame of '{joint.parent}': expected at most "
                f"{longest_link:g} m; in millimetres? give its origin in metres"
            )
    for link, mesh in tree.links.items():
        if not len(mesh.faces):
            continue
        longest = float(mesh.extents.max())
        if longest > longest_link:
            raise HandError(
                f"link '{link}' is {longest:.3g} m long: expected at most {longest_link:g} m; in millimetres? "
                'give its mesh scale="0.001 0.001 0.001", or a basic shape its size in metres'
            )
        if mesh.area > largest:
            raise HandError(
                f"link '{link}' has a surface of {mesh.area:.3g} m^2: expected at most {largest:g} m^2; give it a "
                "simpler shape, or its size in metres"
            )
        if is_flat(mesh):
            raise HandError(
                f"the geometry of link '{link}' is flat: expected a body with a thickness, which physics needs; "
                "give it one, or replace it by a thin box"
            )


def check_joints(tree: Tree, config: HandConfig) -> None:
    """Refuse joints that neither turn nor slide, more than any hand has, and couplings of a slide with an angle."""
    moving = sum(not joint.fixed for joint in tree.joints)
    if moving > MAX_JOINTS:
        raise HandError(
            f"the hand has {moving} joints that move: expected at most {MAX_JOINTS}; leave the hand alone in it"
        )
    for joint in tree.joints:
        if joint.places is not None:
            raise HandError(
                f"joint '{joint.name}': expected type revolute, continuous, prismatic, fixed, got '{joint.places}'; "
                "replace the joint or fix it"
            )
    slides = {joint.name: joint.slides for joint in tree.joints}
    for follower, leader in config.couplings:
        if slides[follower] != slides[leader]:
            raise HandError(
                f"coupling {follower} <= {leader} compares a slide with an angle: expected joints of one kind; mend the pair"
            )
