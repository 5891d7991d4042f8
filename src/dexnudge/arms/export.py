"""A robot written to a folder: arm and hand as one URDF and one MJCF, fixed where the arm stands.

robot.urdf hangs from a link called world; robot.xml has a motor for each actuator of the plan. The hand of its own, as
`export_hand` writes it, lies in hand/.
"""

from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import trimesh

from dexnudge.arms.robot import Robot
from dexnudge.errors import ArmError, check_path
from dexnudge.hands.export import (
    HAND_FILES,
    MESH_FOLDER,
    add_place,
    export_hand,
    mesh_files,
    mjcf_of_hand,
    urdf_of_hand,
    write_meshes,
    write_xml,
)
from dexnudge.hands.motors import Actuator, JointDrives, actuators, nominal_drives
from dexnudge.hands.xml_text import numbers

WORLD, STAND = "world", "world_base"  # the URDF's root and the joint below it
URDF, MJCF, HAND_FOLDER = "robot.urdf", "robot.xml", "hand"
ROBOT_FILES = (URDF, MJCF, f"{MESH_FOLDER}/*.obj", *(f"{HAND_FOLDER}/{file}" for file in HAND_FILES))
"""What `export_robot` writes, as patterns of paths."""
ARM_DAMPING_TIME = 0.03  # [s] kv / kp of an arm's motor: critical where 2 kg m^2 turn, as at a stretched arm's shoulder
ARM_STIFFNESS = 100.0  # [1/rad] kp per effort limit: at the limit an arm's joint gives way by 0.6 degrees
ARM_ARMATURE = 0.1  # [kg m^2] of an arm's geared motors, as MuJoCo Menagerie has it for the Panda


def robot_drives(robot: Robot) -> JointDrives:
    """Return what drives arm and hand: the arm's published effort and velocity, the hand's nominal ones.

    The arm's stiffness is in proportion to its effort, and its motors damp it. The hand's joints are damped as when it is
    alone: a tendon's motor could not keep its two joints from swinging against each other.
    """
    limits, nominal, arm = robot.limits, nominal_drives(robot.body), robot.arm.num_joints
    scale = robot.body.joint_scales[:arm]
    kp = ARM_STIFFNESS * limits.effort[:arm] / scale
    return JointDrives(
        effort=limits.effort,
        velocity=limits.velocity,
        kp=np.concatenate([kp, nominal.kp[arm:]]),
        kv=np.concatenate([ARM_DAMPING_TIME * kp, nominal.kv[arm:]]),
        damping=np.concatenate([np.zeros(arm), nominal.damping[arm:]]),
        armature=np.concatenate([ARM_ARMATURE / scale**2, nominal.armature[arm:]]),
    )


def robot_actuators(robot: Robot) -> list[Actuator]:
    """Return the motors of arm and hand, as in robot.xml."""
    return actuators(robot.body, robot_drives(robot))


def mjcf_of_robot(robot: Robot, files: list[str | None], mesh_folder: str) -> Element:
    """Return the MJCF's root element; `files` names the mesh of each link of `robot.body` in `mesh_folder`.

    The base stands at T_world_base; the controllers of arm and hand compensate gravity. A motor's target has no limits,
    its force has: what presses aims beyond what it touches.
    """
    model = mjcf_of_hand(robot.body, files, mesh_folder, robot_drives(robot))
    SubElement(model, "option", integrator="implicitfast")
    base = model.find("worldbody/body")
    assert base is not None
    pose = robot.arm.T_world_base
    base.set("pos", numbers(pose[:3, 3]))
    base.set("quat", numbers(trimesh.transformations.quaternion_from_matrix(pose)))
    for body in model.iter("body"):
        body.set("gravcomp", "1")
    for motor in model.iterfind("actuator/position"):
        del motor.attrib["ctrlrange"]
    return model


def urdf_of_robot(robot: Robot, files: list[str | None]) -> Element:
    """Return the URDF's root element; the joints of `robot.joint_names` stand first, in their order.

    Raises:
        ArmError: a link or joint has the name of the URDF's root, or of the joint below it.
    """
    body = robot.body
    for kind, name, taken in (
        ("link", WORLD, body.link_names),
        ("joint", STAND, [joint.name for joint in body.joints if joint is not None]),
    ):
        if name in taken:
            raise ArmError(f"{robot!r} has a {kind} '{name}', which stands for where the arm stands; rename it")
    root = urdf_of_hand(body, files, robot_drives(robot))
    first = next(index for index, element in enumerate(root) if element.tag == "link")
    root.insert(first, Element("link", name=WORLD))
    joint = SubElement(root, "joint", name=STAND, type="fixed")
    SubElement(joint, "parent", link=WORLD)
    SubElement(joint, "child", link=body.link_names[0])
    add_place(joint, robot.arm.T_world_base)
    return root


def export_robot(robot: Robot, folder: Path | str) -> Path:
    """Write robot.urdf, robot.xml, meshes/*.obj and hand/ into `folder`, made if need be; return the path of robot.urdf.

    `collision` meshes are the geometry that is judged, `visual` ones what is shown. Masses are nominal, not the robot's.

    Raises:
        ArmError: names that a URDF cannot have.
    """
    check_path("folder", folder)
    folder = Path(folder)
    files = mesh_files(robot.body)
    urdf = urdf_of_robot(robot, files)
    write_meshes(robot.body, files, folder)
    write_xml(urdf, folder / URDF)
    write_xml(mjcf_of_robot(robot, files, MESH_FOLDER), folder / MJCF)
    export_hand(robot.hand, folder / HAND_FOLDER)
    return folder / URDF
