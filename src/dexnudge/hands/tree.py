"""A hand's kinematic tree as a description file states it: links and joints, checked, and given another root."""

from dataclasses import dataclass, field, replace

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import HandError

MAX_LINKS = 1000  # of a hand, or an arm and a hand
CONTINUOUS_LIMIT = np.pi  # [rad] either way: a joint without limits still needs a finite range to sample from
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


def chain_to(tree: Tree, link: str) -> list[TreeJoint]:
    """Return the joints from the root to a link, fixed ones among them."""
    carrier, found = {joint.child: joint for joint in tree.joints}, []
    while link in carrier:
        found.append(carrier[link])
        link = carrier[link].parent
    return found[::-1]


def joints_below(tree: Tree, link: str) -> list[TreeJoint]:
    """Return the joints below a link, parents first."""
    hanging: dict[str, list[TreeJoint]] = {}
    for joint in tree.joints:
        hanging.setdefault(joint.parent, []).append(joint)
    found = list(hanging.get(link, ()))
    for joint in found:
        found += hanging.get(joint.child, ())
    return found


def locked(joint: TreeJoint, value: float) -> TreeJoint:
    """Return a joint fixed where it stands at `value` [rad or m]."""
    if joint.slides:
        motion = trimesh.transformations.translation_matrix(value * joint.axis)
    else:
        motion = trimesh.transformations.rotation_matrix(value, joint.axis)
    return replace(joint, origin=joint.origin @ motion, fixed=True, mimic=None, slides=False)


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


def rerooted(tree: Tree, palm: str) -> Tree:
    """Return the same tree hanging from `palm`.

    A joint on the way from the old root, T_parent_child = O R(a, t), is turned round: the former child carries the former
    parent by R(-a, t). For that the former parent's frame moves by O, and its geometry and other joints by O^-1; the
    frames of links between the old root and the palm therefore differ from the file's.
    """
    above = chain_to(tree, palm)
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
