"""A hand as a MuJoCo model: the palm fixed to the world, a position motor for each motor of the hand.

Joints that share a tendon (follower <= leader) have ONE motor, on the fixed tendon follower + leader, as in Shadow's hands,
and a second tendon, follower - leader with an upper limit of zero, which holds the order as softly as MuJoCo holds any
joint limit. Mimic joints are joint equalities. Pairs of links that always touch are excluded from contact.
MuJoCo takes the convex hull of each mesh for contact.
"""

from xml.etree.ElementTree import Element, SubElement

import numpy as np
import trimesh

from dexnudge.hands.hand import Hand
from dexnudge.hands.physical import JOINT_ARMATURE, JOINT_DAMPING, JOINT_EFFORT, POSITION_GAIN, body_inertia
from dexnudge.hands.xml_numbers import numbers

NO_LOWER_LIMIT = -100.0  # [rad] farther than any joint turns


def mjcf_of_hand(hand: Hand, files: list[str | None], mesh_folder: str) -> Element:
    """The MJCF's root element; `files` names each link's mesh in `mesh_folder`."""
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
        _fill_body(body, hand, link)
        if files[link] is not None:
            SubElement(body, "geom", type="mesh", mesh=name)
    _add_exclusions(model, hand)
    _add_equalities(model, hand)
    _add_motors(model, hand)
    return model


def _placement(hand: Hand, link: int) -> dict[str, str]:
    joint = hand.joints[link]
    if joint is None:
        return {}
    quaternion = trimesh.transformations.quaternion_from_matrix(joint.origin)
    return {"pos": numbers(joint.origin[:3, 3]), "quat": numbers(quaternion)}


def _fill_body(body: Element, hand: Hand, link: int) -> None:
    inertia = body_inertia(hand.link_meshes[link])
    diagonal = numbers(inertia.diagonal)
    SubElement(body, "inertial", pos=numbers(inertia.centre), mass=numbers([inertia.mass]), diaginertia=diagonal)
    joint = hand.joints[link]
    if joint is not None and joint.index is not None:
        ends = joint.multiplier * np.array([hand.lower[joint.index], hand.upper[joint.index]]) + joint.offset
        SubElement(body, "joint", name=joint.name, axis=numbers(joint.axis), range=numbers(np.sort(ends)))


def _add_exclusions(model: Element, hand: Hand) -> None:
    contact = SubElement(model, "contact")
    solid = [link for link, mesh in enumerate(hand.link_meshes) if len(mesh.faces)]
    allowed = set(hand.self_collision_pairs)
    for one in solid:
        for other in solid:
            if one < other and (one, other) not in allowed:
                SubElement(contact, "exclude", body1=hand.link_names[one], body2=hand.link_names[other])


def _add_equalities(model: Element, hand: Hand) -> None:
    equality = SubElement(model, "equality")
    for joint in hand.joints:
        if joint is not None and joint.index is not None and joint.name != hand.joint_names[joint.index]:
            polynomial = numbers([joint.offset, joint.multiplier, 0.0, 0.0, 0.0])
            SubElement(equality, "joint", joint1=joint.name, joint2=hand.joint_names[joint.index], polycoef=polynomial)


def _add_motors(model: Element, hand: Hand) -> None:
    tendon, actuator = SubElement(model, "tendon"), SubElement(model, "actuator")
    gains = {"kp": numbers([POSITION_GAIN]), "forcerange": numbers([-JOINT_EFFORT, JOINT_EFFORT])}
    coupled = {name for pair in hand.couplings for name in pair}
    for index, name in enumerate(hand.joint_names):
        if name not in coupled:
            limits = numbers([hand.lower[index], hand.upper[index]])
            SubElement(actuator, "position", gains, name=name, joint=name, ctrlrange=limits)
    for (follower, leader), pair in zip(hand.couplings, hand.coupled_indices, strict=True):
        order = SubElement(tendon, "fixed", name=f"{follower}<={leader}", range=numbers([NO_LOWER_LIMIT, 0.0]))
        shared = SubElement(tendon, "fixed", name=f"{follower}+{leader}")
        for element, sign in ((order, -1.0), (shared, 1.0)):
            SubElement(element, "joint", joint=follower, coef="1")
            SubElement(element, "joint", joint=leader, coef=numbers([sign]))
        limits = numbers([hand.lower[pair].sum(), hand.upper[pair].sum()])
        SubElement(
            actuator,
            "position",
            gains,
            name=shared.get("name") or "",
            tendon=shared.get("name") or "",
            ctrlrange=limits,
        )
