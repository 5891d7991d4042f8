"""A hand written to a folder: URDF, meshes, the YAML beside them, and MJCF. What `load_hand` reads back is the same hand.

Meshes are OBJ with every digit, so that points drawn on them after reading are the same points.
"""

import re
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import check_path
from dexnudge.hands.config import HandConfig, write_hand_config
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import visual_meshes
from dexnudge.hands.motors import JOINT_ARMATURE, JOINT_DAMPING, JointDrives, actuators, nominal_drives
from dexnudge.hands.xml_text import numbers

MESH_FOLDER = "meshes"
SHOWN = "visual_"  # before the names of meshes that are only shown
LONGEST_NAME = 100  # characters of a link in the name of its file
HAND_FILES = ("hand.urdf", "hand.yaml", "hand.xml", f"{MESH_FOLDER}/*.obj")
"""What `export_hand` writes, as patterns of paths."""


def export_hand(hand: Hand, folder: Path | str) -> Path:
    """Write hand.urdf, hand.yaml, hand.xml (MJCF) and meshes/*.obj into `folder`, made if need be.

    The root link is the palm. `collision` meshes are the geometry that is judged, `visual` ones what is shown. Masses and
    motor limits are nominal values, not the real hand's.

    Returns:
        the path of hand.urdf.
    """
    check_path("folder", folder)
    folder = Path(folder)
    files = mesh_files(hand)
    write_meshes(hand, files, folder)
    write_hand_config(
        HandConfig(
            palm=hand.link_names[0],
            fingertips=hand.fingertips,
            palm_normal=tuple(hand.palm_normal.tolist()),
            couplings=hand.couplings,
            base_link=hand.base_link,
            name=hand.name,
        ),
        folder / "hand.yaml",
    )
    write_xml(mjcf_of_hand(hand, files, MESH_FOLDER), folder / "hand.xml")
    write_xml(urdf_of_hand(hand, files), folder / "hand.urdf")
    return folder / "hand.urdf"


def mesh_files(hand: Hand) -> list[str | None]:
    """Return a file name for each link with geometry, safe on every file system whatever the link is called."""
    safe = [re.sub(r"[^A-Za-z0-9_-]", "_", name) for name in hand.link_names]
    return [
        f"{link:02d}_{safe[link][:LONGEST_NAME]}.obj" if len(mesh.faces) else None
        for link, mesh in enumerate(hand.link_meshes)
    ]


def write_meshes(hand: Hand, files: list[str | None], folder: Path) -> None:
    """Write the links' meshes, judged and shown, into `folder`/meshes, made if need be."""
    (folder / MESH_FOLDER).mkdir(parents=True, exist_ok=True)
    for file, judged, shown in zip(files, hand.link_meshes, visual_meshes(hand), strict=True):
        if file is not None:
            (folder / MESH_FOLDER / file).write_text(obj_text(judged), encoding="ascii")
            if shown is not judged:
                (folder / MESH_FOLDER / f"{SHOWN}{file}").write_text(obj_text(shown), encoding="ascii")


def obj_text(mesh: trimesh.Trimesh) -> str:
    """Wavefront OBJ with vertices and faces in the mesh's order, every coordinate in as many digits as make it exact."""
    vertices = "\n".join(f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist())
    faces = "\n".join(f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist())
    return f"{vertices}\n{faces}\n"


def urdf_of_hand(hand: Hand, files: list[str | None], drives: JointDrives | None = None) -> Element:
    """Return the URDF's root element; independent joints stand first, in the order of q."""
    drives = drives or nominal_drives(hand)
    robot = Element("robot", name=hand.name)
    # MuJoCo's own defaults would drop the folder of the meshes and merge fixed links into their parents.
    compiler = {"strippath": "false", "discardvisual": "true", "fusestatic": "false", "balanceinertia": "true"}
    SubElement(SubElement(robot, "mujoco"), "compiler", compiler)
    for link, name in enumerate(hand.link_names):
        element = SubElement(robot, "link", name=name)
        _add_inertial(element, hand.link_meshes[link])
        if files[link] is not None:
            prefix = "" if visual_meshes(hand)[link] is hand.link_meshes[link] else SHOWN
            for kind, start in (("visual", prefix), ("collision", "")):
                geometry = SubElement(SubElement(element, kind), "geometry")
                SubElement(geometry, "mesh", filename=f"{MESH_FOLDER}/{start}{files[link]}")
    for link in sorted(range(1, len(hand.link_names)), key=lambda link: _rank(hand, link)):
        _add_joint(robot, hand, drives, link)
    return robot


def euler_angles(rotation: Float[np.ndarray, "3 3"]) -> tuple[float, float, float]:
    """Return roll, pitch, yaw [rad] with R = Rz(yaw) Ry(pitch) Rx(roll), exact also where pitch comes near 90 degrees."""
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    rest = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]) @ rotation
    return (
        float(np.arctan2(-rest[1, 2], rest[1, 1])),
        float(np.arctan2(-rest[2, 0], rest[0, 0])),
        float(yaw),
    )


def _rank(hand: Hand, link: int) -> tuple[int, int]:
    joint = hand.joints[link]
    assert joint is not None
    return (hand.joint_names.index(joint.name) if joint.name in hand.joint_names else hand.num_joints, link)


def _add_joint(robot: Element, hand: Hand, drives: JointDrives, link: int) -> None:
    joint = hand.joints[link]
    assert joint is not None
    kind = "fixed" if joint.index is None else "prismatic" if joint.slides else "revolute"
    element = SubElement(robot, "joint", name=joint.name, type=kind)
    SubElement(element, "parent", link=hand.link_names[hand.link_parent[link]])
    SubElement(element, "child", link=hand.link_names[link])
    add_place(element, joint.origin)
    if joint.index is None:
        return
    SubElement(element, "axis", xyz=numbers(joint.axis))
    leader = hand.joint_names[joint.index]
    ends = joint.multiplier * np.array([hand.lower[joint.index], hand.upper[joint.index]]) + joint.offset
    limits = {"lower": numbers([ends.min()]), "upper": numbers([ends.max()])}
    ratio = joint.scale / hand.joint_scales[joint.index]
    effort, velocity = numbers([drives.effort[joint.index] / ratio]), numbers([drives.velocity[joint.index] * ratio])
    SubElement(element, "limit", limits, effort=effort, velocity=velocity)
    if joint.name != leader:
        multiplier, offset = numbers([joint.multiplier]), numbers([joint.offset])
        SubElement(element, "mimic", joint=leader, multiplier=multiplier, offset=offset)


def add_place(element: Element, pose: Float[np.ndarray, "4 4"]) -> None:
    """Give an element of a URDF an <origin>."""
    SubElement(element, "origin", xyz=numbers(pose[:3, 3]), rpy=numbers(euler_angles(pose[:3, :3])))


def _add_inertial(link: Element, mesh: trimesh.Trimesh) -> None:
    body = body_inertia(mesh)
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=numbers(body.centre), rpy="0 0 0")
    SubElement(inertial, "mass", value=numbers([body.mass]))
    diagonal = dict(zip(("ixx", "iyy", "izz"), (numbers([value]) for value in body.diagonal), strict=True))
    SubElement(inertial, "inertia", diagonal, ixy="0", ixz="0", iyz="0")


def write_xml(root: Element, path: Path) -> None:
    """Write an element and what is in it, indented."""
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


DENSITY = 1000.0  # [kg/m^3] plastic housing with motors; gives the Shadow Hand's fingers their published 10-20 g
MIN_MASS = 0.002  # [kg] of links without geometry, as the Shadow model in gymnasium-robotics has it
MIN_INERTIA = 1.0e-6  # [kg m^2] keeps small links stable at time steps of some milliseconds


@dataclass(frozen=True)
class BodyInertia:
    """Mass [kg], centre of mass [m, link frame], moments of inertia about it along the link's axes [kg m^2]."""

    mass: float
    centre: Float[np.ndarray, " 3"]
    diagonal: Float[np.ndarray, " 3"]


def body_inertia(mesh: trimesh.Trimesh) -> BodyInertia:
    """Return the inertia of a box as large as the mesh's bounding box, with the mass of its convex hull."""
    if len(mesh.faces) == 0:
        return BodyInertia(MIN_MASS, np.zeros(3), np.full(3, MIN_INERTIA))
    mass = max(MIN_MASS, DENSITY * mesh.convex_hull.volume)
    squares = np.asarray(mesh.extents) ** 2
    return BodyInertia(mass, mesh.bounds.mean(axis=0), np.maximum(MIN_INERTIA, mass / 12 * (squares.sum() - squares)))


NO_LOWER_LIMIT = -100.0  # [rad] farther than any joint turns


def mjcf_of_hand(hand: Hand, files: list[str | None], mesh_folder: str, drives: JointDrives | None = None) -> Element:
    """Return the MJCF's root element; `files` names each link's mesh in `mesh_folder`, `drives` are nominal if left out."""
    drives = drives or nominal_drives(hand)
    model = Element("mujoco", model=hand.name)
    SubElement(model, "compiler", angle="radian", meshdir=mesh_folder, autolimits="true")
    default = SubElement(model, "default")
    SubElement(default, "joint", damping=numbers([JOINT_DAMPING]), armature=numbers([JOINT_ARMATURE]))
    asset = SubElement(model, "asset")
    for name, file in zip(hand.link_names, files, strict=True):
        if file is not None:
            SubElement(asset, "mesh", name=name, file=file)
    parents = [SubElement(model, "worldbody")]
    for link, name in enumerate(hand.link_names):
        parent = parents[0] if link == 0 else parents[hand.link_parent[link] + 1]
        body = SubElement(parent, "body", {"name": name, **_placement(hand, link)})
        parents.append(body)
        _fill_body(body, hand, link, drives)
        if files[link] is not None:
            SubElement(body, "geom", type="mesh", mesh=name)
    _add_exclusions(model, hand)
    _add_equalities(model, hand)
    _add_motors(model, hand, drives)
    return model


def _placement(hand: Hand, link: int) -> dict[str, str]:
    joint = hand.joints[link]
    if joint is None:
        return {}
    quaternion = trimesh.transformations.quaternion_from_matrix(joint.origin)
    return {"pos": numbers(joint.origin[:3, 3]), "quat": numbers(quaternion)}


def _fill_body(body: Element, hand: Hand, link: int, drives: JointDrives) -> None:
    inertia = body_inertia(hand.link_meshes[link])
    diagonal = numbers(inertia.diagonal)
    SubElement(body, "inertial", pos=numbers(inertia.centre), mass=numbers([inertia.mass]), diaginertia=diagonal)
    joint = hand.joints[link]
    if joint is not None and joint.index is not None:
        ends = joint.multiplier * np.array([hand.lower[joint.index], hand.upper[joint.index]]) + joint.offset
        element = SubElement(body, "joint", name=joint.name, axis=numbers(joint.axis), range=numbers(np.sort(ends)))
        if joint.slides:
            element.set("type", "slide")
        ratio = joint.scale / hand.joint_scales[joint.index]  # of a slide that follows a turning joint, or vice versa
        for key, default in (("damping", JOINT_DAMPING), ("armature", JOINT_ARMATURE)):
            value = float(vars(drives)[key][joint.index]) / ratio**2
            if value != default:
                element.set(key, numbers([value]))


def _add_exclusions(model: Element, hand: Hand) -> None:
    contact = SubElement(model, "contact")
    solid = [link for link, mesh in enumerate(hand.link_meshes) if len(mesh.faces)]
    for one, other in sorted({*combinations(solid, 2)} - {*hand.self_collision_pairs}):
        SubElement(contact, "exclude", body1=hand.link_names[one], body2=hand.link_names[other])


def _add_equalities(model: Element, hand: Hand) -> None:
    equality = SubElement(model, "equality")
    for joint in hand.joints:
        if joint is not None and joint.index is not None and joint.name != hand.joint_names[joint.index]:
            polynomial = numbers([joint.offset, joint.multiplier, 0.0, 0.0, 0.0])
            SubElement(equality, "joint", joint1=joint.name, joint2=hand.joint_names[joint.index], polycoef=polynomial)


def _add_motors(model: Element, hand: Hand, drives: JointDrives) -> None:
    tendon, actuator = SubElement(model, "tendon"), SubElement(model, "actuator")
    for follower, leader in hand.couplings:
        order = SubElement(tendon, "fixed", name=f"{follower}<={leader}", range=numbers([NO_LOWER_LIMIT, 0.0]))
        shared = SubElement(tendon, "fixed", name=f"{follower}+{leader}")
        for element, sign in ((order, -1.0), (shared, 1.0)):
            SubElement(element, "joint", joint=follower, coef="1")
            SubElement(element, "joint", joint=leader, coef=numbers([sign]))
    for motor in actuators(hand, drives):
        values = {"kp": [motor.kp], "forcerange": [-motor.effort, motor.effort]}
        if motor.own_kv:
            values["kv"] = [motor.own_kv]
        values["ctrlrange"] = [motor.lower, motor.upper]
        moved = "joint" if motor.name in hand.joint_names else "tendon"
        attributes = {key: numbers(value) for key, value in values.items()}
        SubElement(actuator, "position", attributes, name=motor.name, **{moved: motor.name})
