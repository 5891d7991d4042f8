"""Where an arm ends: the flange among a description's links, and what of the rest belongs to the arm."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.arms.arm import Arm
from dexnudge.arms.config import ArmConfig
from dexnudge.errors import ArmError, did_you_mean
from dexnudge.hands.assembly import WORLD
from dexnudge.hands.joint_ranges import line_of
from dexnudge.hands.tree import Tree, TreeJoint

LEAST_JOINTS = 4  # fewer bring a hand to few poses: a wrist, or a gripper
ALONG = np.cos(np.radians(10.0))  # of the flange's z-axis to the last joint's
LEAST_AWAY = 0.001  # [m] of a flange from its last joint, along the axis, that tells on which side it lies
MOST_NAMED = 20  # links in a message
# Names of flanges, the surest first. ROS-Industrial's tool0 has z out of the arm, where its flange has x.
NAMES = (
    "tool0",
    "flange",
    "attachment_site",
    "attachment",
    "link_?8",
    "link_?eef",
    "link_?ee",
    "eef?(_link)?",
    "end_?effector(_link|_frame)?",
    "tool(_link|_frame)",
    "mount(ing)?_?(flange|plate)?",
)


def from_base(tree: Tree, config: ArmConfig) -> Tree:
    """Return what hangs below the arm's base, without joints that place it and without an empty world; see `notes`."""
    if config.base is not None:
        _check_link(config.base, "base", tree)
        return tree.below(config.base)
    root = tree.root
    while (first := tree.hanging.get(root)) and not len(tree.links[root].faces):
        places = first[0].places is not None or (first[0].fixed and root == WORLD)
        if len(first) > 1 or not places:
            break
        if not first[0].fixed or not np.allclose(first[0].origin, np.eye(4)):
            note = f"the base is '{first[0].child}': joint '{first[0].name}', which places it in the world, was cut off"
            tree = replace(tree, notes=(*tree.notes, note))
        root = first[0].child
    # MuJoCo keeps the name for itself.
    return tree.below(root).renamed(lambda link: f"{WORLD}_link" if link == WORLD else link)


def find_flange(tree: Tree, source: str) -> str:
    """Return the link that a hand is mounted on, where that is clear.

    Raises:
        ArmError: it is not clear; the message names the links that may be meant.
    """
    turns = {link: sum(map(_turns, tree.chain_to(link))) for link in tree.links}
    ends = [link for link in tree.links if turns[link] >= LEAST_JOINTS]
    if not ends:
        most = max(turns.values(), default=0)
        raise ArmError(
            f"{source}: expected an arm of at least {LEAST_JOINTS} joints one after another, found {most}; name a "
            "description with an arm"
        )
    named = [[link for link in ends if _is_called(link, name) and _points_out(tree, link)] for name in NAMES]
    best: Sequence[str] = next((links for links in named if links), ())
    if len(best) == 1:
        return best[0]
    leaves = [link for link in ends if link not in tree.hanging]
    bare = [link for link in leaves if not len(tree.links[link].faces) and _points_out(tree, link)]
    if not best and len(leaves) == len(bare) == 1 and not tree.carrier[bare[0]].mimic:
        return bare[0]
    shown = list(best) or _likely_first(ends, turns, tree)
    more = f" and {len(shown) - MOST_NAMED} more" if len(shown) > MOST_NAMED else ""
    raise ArmError(
        f"{source}: an arm without the flange named: expected the link that a hand is mounted on, z out of the arm; it may "
        f"be one of {', '.join(shown[:MOST_NAMED])}{more}; write 'flange: LINK' into the YAML beside the description"
    )


def _likely_first(links: list[str], turns: dict[str, int], tree: Tree) -> list[str]:
    """Return the links at which arms end before the ends of fingers, and before those from which one more joint goes on."""
    bodies = {tree.root: tree.root}
    for joint in tree.joints_below(tree.root):
        bodies[joint.child] = bodies[joint.parent] if joint.fixed else joint.child
    goes_on = Counter(bodies[joint.parent] for joint in tree.joints if not joint.fixed)
    return sorted(links, key=lambda link: (goes_on[bodies[link]] == 1, turns[link]))


def cut_at(tree: Tree, flange: str, source: str) -> Tree:
    """Return the way from the base to the flange, and what is fixed to it or follows its joints; see `notes`.

    Raises:
        ArmError: no such link, too few joints, or one that follows a joint of something else.
    """
    _check_link(flange, "flange", tree)
    root, of_way = tree.root, tree.chain_to(flange)
    joints = {joint.name: joint for joint in tree.joints}
    own = {joint.name for joint in of_way if not joint.fixed and joint.mimic is None}
    for joint in of_way:
        line = line_of(joints, joint.name) if joint.mimic is not None and not joint.fixed else None
        if joint.places is not None or (joint.mimic is not None and (line is None or line[0] not in own)):
            follows = f"follows '{getattr(joint.mimic, 'leader', '')}'"
            kind = f"moves as a {joint.places} joint" if joint.places else follows
            raise ArmError(
                f"{source}: joint '{joint.name}' between base and flange {kind}: expected joints that turn or slide, or "
                "follow one between base and flange; mend the joint, or name another flange or base"
            )
    if len(own) < LEAST_JOINTS:
        raise ArmError(
            f"{source}: expected at least {LEAST_JOINTS} joints between base and flange, found {len(own)} between "
            f"'{root}' and '{flange}'; name another flange, or another arm"
        )
    moving = max(number for number, joint in enumerate(of_way) if not joint.fixed)
    last = {joint.child for joint in of_way[moving:]}
    kept, cut = {root, *(joint.child for joint in of_way)}, []
    for joint in tree.joints_below(root):
        if joint.child in kept or joint.parent not in kept:
            continue
        line = None if joint.fixed else line_of(joints, joint.name)
        stays = joint.fixed or (line is not None and line[0] in own)
        grips = joint.parent in last and any(not other.fixed for other in tree.joints_below(joint.child))
        if joint.parent == flange or grips or not stays:
            cut.append(joint)
        else:
            kept.add(joint.child)
    solid = [joint.child for joint in cut if any(len(mesh.faces) for mesh in tree.below(joint.child).links.values())]
    order = [root, *(joint.child for joint in tree.joints_below(root))]
    links = {name: tree.links[name] for name in order if name in kept}
    kept_joints = tuple(joint for joint in tree.joints if joint.child in kept)
    notes = (f"cut off, with all that hangs there: {', '.join(solid)}",) if solid else ()
    return replace(tree, links=links, joints=kept_joints, notes=(*tree.notes, *notes))


def _check_link(link: str, key: str, tree: Tree) -> None:
    if link not in tree.links:
        shown = list(tree.links)
        more = f" and {len(shown) - MOST_NAMED} more" if len(shown) > MOST_NAMED else ""
        raise ArmError(
            f"the arm's YAML names an unknown link: key '{key}': expected one of {', '.join(shown[:MOST_NAMED])}{more}, got "
            f"'{link}'{did_you_mean(link, shown)}; mend it"
        )


def _turns(joint: TreeJoint) -> bool:
    return not joint.fixed and joint.mimic is None and joint.places is None


def _is_called(link: str, name: str) -> bool:
    return re.fullmatch(rf"(.*[^a-z0-9])?{name}", link.lower()) is not None


def last_axis(tree: Tree, link: str) -> np.ndarray:
    """Return the axis of the last joint that moves a link, in the link's frame."""
    return _last_joint(tree, link)[0]


def _last_joint(tree: Tree, link: str) -> tuple[np.ndarray, np.ndarray]:
    """Return axis and place [m] of the last joint that moves a link, in the link's frame."""
    T_joint_link = np.eye(4)
    for joint in reversed(tree.chain_to(link)):
        if not joint.fixed:
            return np.asarray(T_joint_link[:3, :3].T @ joint.axis), np.linalg.inv(T_joint_link)[:3, 3]
        T_joint_link = joint.origin @ T_joint_link
    return np.array([0.0, 0.0, 1.0]), np.zeros(3)


def _points_out(tree: Tree, link: str) -> bool:
    return bool(abs(last_axis(tree, link)[2]) > ALONG)


def outward_frame(arm: Arm) -> Float[np.ndarray, "4 4"]:
    """Return a frame in the flange's: z along that axis of the flange that is nearest the last joint's, out of the arm.

    Out is away from the last joint, or from the geometry that does not move with the flange where that lies in the joint.
    """
    axis, place = _last_joint(arm.tree, arm.flange)
    nearest = int(np.abs(axis).argmax())
    if nearest == 2:
        return np.eye(4)
    behind = place[nearest]
    if abs(behind) < LEAST_AWAY:
        poses, still = arm.link_poses(arm.home), arm.rigid_with(arm.flange)
        flange = np.linalg.inv(poses[arm.flange])
        meshes = [(link, mesh) for link, mesh in arm.tree.links.items() if link not in still and len(mesh.faces)]
        points = [trimesh.transform_points(mesh.vertices, flange @ poses[link]) for link, mesh in meshes[-2:]]
        behind = np.concatenate(points)[:, nearest].mean() if points else -1.0
    z = np.eye(3)[nearest] * (-1.0 if behind > 0 else 1.0)
    x = np.eye(3)[(nearest + 1) % 3]
    outward = np.eye(4)
    outward[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return outward
