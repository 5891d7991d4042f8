"""A hand as MJCF: bodies with their masses, joints, equalities, tendons, motors, and which links may touch."""

from dataclasses import dataclass
from itertools import combinations
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.hands.hand import Hand
from dexnudge.hands.motors import JOINT_ARMATURE, JOINT_DAMPING, JointDrives, actuators, nominal_drives
from dexnudge.hands.xml_text import numbers

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
