"""How a hand is mounted on an arm's flange, and which mounts cannot be."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.arms.arm import Arm, rigid_pose
from dexnudge.arms.flange import outward_frame
from dexnudge.arms.robot import Robot
from dexnudge.errors import ArmError, check_kind
from dexnudge.geometry.overlap import deepest_overlap
from dexnudge.hands.hand import Hand

# Of named pairs: turn of the palm about the flange's z-axis, and tilt of the fingers from that axis to where the palm
# faces [deg]; a wedge makes it. Of tilts in steps of 15 degrees these bring the arm to most of the configurations that were
# sampled on tables and in shelves, as far as the surroundings let it.
WEDGES: dict[tuple[str, str], tuple[float, float]] = {
    ("panda", "allegro"): (45.0, 15.0),
    ("xarm7", "allegro"): (0.0, 15.0),
    ("ur5e", "allegro"): (0.0, 15.0),
}
# The same of pairs with a bracket beside the flange, and how far from the flange's axis the hand begins [m]: fingers across
# the arm's last axis get deep into a shelf while the wrist stays outside.
BRACKETS: dict[tuple[str, str], tuple[float, float, float]] = {("panda", "shadow_lite"): (45.0, 80.0, 0.02)}
# Of pairs of one maker the pose itself; there, the hand's housing encloses the flange.
MAKERS = {("panda", "panda_gripper"): trimesh.transformations.rotation_matrix(np.radians(-45.0), (0.0, 0.0, 1.0))}
FLANGES = {"panda": "panda_link8", "ur5e": "attachment_site", "xarm7": "link_eef"}  # of the arms in these tables
GAP = 0.002  # [m] between the flange's plane and the hand: an adapter plate, and no overlap by rounding
REAR = 0.02  # [m] of what is held, next to the flange: its middle lies on the flange's axis
STEP, MOST_STEPS = 0.005, 21  # [m] by which the hand moves out where the arm's geometry reaches beyond its flange
SHORTEST_COLUMN, COLUMN_RADIUS = 0.02, 0.025  # [m] what stands between the flange and a hand farther out than that
COLUMN_SIDES = 24
SNAP = np.cos(np.radians(15.0))  # a mount whose axis is that near the fingers' is screwed on along it; a base always is
DEEPEST = 0.001  # [m] by which hand and arm may overlap: meshes of two makers that bolt together


def mount(arm: Arm, hand: Hand, T_flange_mount: Any = None) -> Robot:
    """Return the robot of an arm that carries a hand.

    Args:
        arm: the arm, where it stands.
        hand: the hand.
        T_flange_mount: (4, 4) pose of the hand's base, or of its palm where it has none, in the flange's frame;
            `default_mount` unless given.

    Raises:
        ArmError: no rigid pose, or one that turns the hand into the arm: they overlap by more than 1 mm at the arm's home.
    """
    check_kind("arm", arm, Arm, 'load_arm("panda")')
    check_kind("hand", hand, Hand, 'load_hand("shadow_lite")')
    given = T_flange_mount is not None
    pose = rigid_pose(T_flange_mount, "T_flange_mount") if given else default_mount(arm, hand)
    robot = Robot(_with_column(arm, hand, pose), hand, pose)
    met = sorted(_overlaps(robot), reverse=True)
    if met:
        links = ", ".join(f"'{of_hand}' {1e3 * depth:.0f} mm into '{of_arm}'" for depth, of_hand, of_arm in met[:3])
        rigid = arm.rigid_with(arm.flange)
        everywhere = any(of_arm in rigid for _, _, of_arm in met)
        raise ArmError(
            f"this mount turns the hand into the arm: {links}, {'whatever the joint angles' if everywhere else 'at home'}; "
            f"expected an overlap of at most {1e3 * DEEPEST:g} mm; mend `mount`"
            f"{', or name a flange before that link: what hangs from it is cut off' if everywhere else ' or the home'}; "
            "z of the flange points out of the arm"
        )
    return robot


def _with_column(arm: Arm, hand: Hand, T_flange_mount: Float[np.ndarray, "4 4"]) -> Arm:
    """Return the arm with a column on its flange that reaches to a hand which is mounted farther out."""
    outward = outward_frame(arm)
    points = trimesh.transform_points(_hand_points(hand, _at_rest(hand)[0]), np.linalg.inv(outward) @ T_flange_mount)
    length = float(points[:, 2].min()) - GAP
    if length < SHORTEST_COLUMN:
        return arm
    middle = trimesh.transformations.translation_matrix([0.0, 0.0, length / 2])
    column = trimesh.creation.cylinder(COLUMN_RADIUS, length, sections=COLUMN_SIDES, transform=outward @ middle)
    own = arm.tree.links[arm.flange]
    links = {**arm.tree.links, arm.flange: trimesh.util.concatenate([own, column]) if len(own.faces) else column}
    return replace(arm, tree=replace(arm.tree, links=links))


def default_mount(arm: Arm, hand: Hand) -> Float[np.ndarray, "4 4"]:
    """Return T_flange_mount: the hand's fingers continue the flange's z-axis, its palm faces the flange's x-axis.

    Of a flange whose z-axis does not lie along the last joint's they continue the axis that does. A hand with a base, such
    as a forearm, stands on the flange by the axis of the base that is nearest the fingers. Of the named pairs it is turned
    and tilted by `WEDGES`. The hand begins 2 mm in front of the flange's plane, or up to 0.1 m farther out where the arm's
    geometry reaches beyond it; the middle of its base's or palm's side there lies on the flange's axis. The room behind a
    tilted hand is a wedge's.
    On a bracket (`BRACKETS`) base or palm begin 2 mm in front of the flange's plane, beside its axis.
    """
    pair = _pair(arm, hand)
    if pair in MAKERS:
        return MAKERS[pair].copy()
    bracket = BRACKETS.get(pair)
    turn, tilt = bracket[:2] if bracket else WEDGES.get(pair, (0.0, 0.0))
    poses, axis, normal = _at_rest(hand)
    T_flange_mount = np.eye(4)
    wedge = Rotation.from_euler("ZY", [turn, tilt], degrees=True).as_matrix()
    T_flange_mount[:3, :3] = wedge @ np.stack([normal, np.cross(axis, normal), axis])  # in the outward frame, so far
    points = trimesh.transform_points(_hand_points(hand, poses), T_flange_mount)
    held = hand.link_meshes[_mount_index(hand)].vertices
    held = trimesh.transform_points(held, T_flange_mount) if len(held) else points
    fingers = T_flange_mount[:3, :3] @ axis if bracket else np.array([0.0, 0.0, 1.0])
    rear = held[held @ fingers < (held @ fingers).min() + REAR]
    T_flange_mount[:2, 3] = -(rear.min(axis=0) + rear.max(axis=0))[:2] / 2
    T_flange_mount[2, 3] = GAP - (held if bracket else points)[:, 2].min()
    if bracket:
        T_flange_mount[:2, 3] += bracket[2] * fingers[:2] / np.linalg.norm(fingers[:2])
        return T_flange_mount
    outward = outward_frame(arm)
    for step in range(MOST_STEPS):
        pose = outward @ trimesh.transformations.translation_matrix([0.0, 0.0, step * STEP]) @ T_flange_mount
        if not any(_overlaps(Robot(arm, hand, pose))):
            return np.asarray(pose)
    return np.asarray(outward @ T_flange_mount)


def _pair(arm: Arm, hand: Hand) -> tuple[str, str]:
    """Return the names by which a pair is known; of an arm that only shares its name with one of ours, none is."""
    return (arm.name if FLANGES.get(arm.name) == arm.flange else "", hand.name)


def _mount_index(hand: Hand) -> int:
    return hand.link_names.index(hand.base_link or hand.link_names[0])


def _at_rest(
    hand: Hand,
) -> tuple[Float[np.ndarray, "link 4 4"], Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Return T_mount_link of the open hand, where its fingers point, and where its palm faces, in the mount's frame."""
    poses = hand.forward_kinematics(hand.at_origin(hand.apart[None]))[0].numpy()
    T_mount_palm = np.linalg.inv(poses[_mount_index(hand)])
    normal = hand.palm_normal / np.linalg.norm(hand.palm_normal)
    axis, normal = (normal, hand.finger_axis) if hand.fingers_face else (hand.finger_axis, normal)
    axis, normal = T_mount_palm[:3, :3] @ axis, T_mount_palm[:3, :3] @ normal
    own = np.eye(3)[np.abs(axis).argmax()] * np.sign(axis[np.abs(axis).argmax()])
    if hand.base_link or axis @ own > SNAP:
        axis = own
    normal = normal - (normal @ axis) * axis
    return T_mount_palm @ poses, axis, normal / np.linalg.norm(normal)


def _hand_points(hand: Hand, poses: Float[np.ndarray, "link 4 4"]) -> Float[np.ndarray, "n 3"]:
    return np.concatenate(
        [trimesh.transform_points(mesh.vertices, pose) for mesh, pose in zip(hand.link_meshes, poses, strict=True)]
    )


def _overlaps(robot: Robot) -> Iterator[tuple[float, str, str]]:
    """Yield (depth [m], link of the hand, link of the arm) of those that overlap too deep with the arm at home."""
    body, arm, hand = robot.body, robot.arm, robot.hand
    makers = MAKERS.get(_pair(arm, hand))
    bolted = makers is not None and np.allclose(makers, robot.T_flange_mount, atol=DEEPEST)
    housed = {(link, robot.mount) for link in arm.rigid_with(arm.flange)} if bolted else set()
    placed = [mesh.copy().apply_transform(pose) for mesh, pose in zip(body.link_meshes, robot.at_home(), strict=True)]
    solid = [index for index, mesh in enumerate(placed) if len(mesh.faces)]
    links = len(arm.tree.links)
    for mine in (index for index in solid if index < links):
        for other in (index for index in solid if index >= links):
            one, two = placed[mine].bounds, placed[other].bounds
            near = (one[0] < two[1]).all() and (two[0] < one[1]).all()
            if near and (body.link_names[mine], body.link_names[other]) not in housed:
                depth = deepest_overlap(placed[other], placed[mine])[0]
                if depth > DEEPEST:
                    yield depth, body.link_names[other], body.link_names[mine]
