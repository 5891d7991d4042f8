"""Arm, hand, object and surroundings as one MuJoCo model: the arm stands fixed at its base and moves by its own motors."""

from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
from jaxtyping import Float

from dexnudge.arms.export import mjcf_of_robot
from dexnudge.arms.robot import Robot
from dexnudge.errors import InputError
from dexnudge.hands.xml_text import numbers, refuse_entities
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.convex_pieces import environment_pieces
from dexnudge.simulation.model import (
    SimulationModel,
    add_scene,
    add_self_contacts,
    indexed,
    link_surface,
    spec_of_links,
)
from dexnudge.simulation.surface_pieces import REACH


@dataclass(frozen=True)
class RobotModel:
    """The model of a robot in a scene; `simulation.hand` is the robot's body, links of the arm count as the hand's.

    The motors are `robot_actuators`, in the same order.
    """

    robot: Robot
    simulation: SimulationModel

    def place(self, position: Float[np.ndarray, " n"]) -> None:
        """Reset everything: arm and hand at `position` [rad], at rest, the object where the scene has it."""
        self.simulation.place(self.robot.coordinates(position[None])[0])

    def xml_at(self, position: Float[np.ndarray, " n"]) -> str:
        """Return the model's text with a key frame, "start", in which the robot stands at `position` [rad], at rest."""
        self.place(position)
        root = ElementTree.fromstring(self.simulation.xml)  # noqa: S314 - the text is our own
        values = {name: numbers(getattr(self.simulation.data, name)) for name in ("qpos", "ctrl")}
        ElementTree.SubElement(ElementTree.SubElement(root, "keyframe"), "key", values, name="start")
        return ElementTree.tostring(root, encoding="unicode")

    def positions(self, qpos: Float[np.ndarray, "k nq"]) -> Float[np.ndarray, "k n"]:
        """Return the joint angles of arm and hand for MuJoCo's coordinates."""
        return np.asarray(self.simulation.configurations(qpos)[:, -len(self.robot.joint_names) :])


def robot_model(robot: Robot, scene: Scene) -> RobotModel:
    """Return the model of a robot in a scene: contacts, frictions and options are those of `scene_model`.

    Arm and hand touch the object and the surroundings, links of the hand each other; the arm touches no link of the robot.

    Raises:
        MeshError: object, surroundings or a link cannot be cut into convex pieces.
    """
    body = robot.body
    no_files: list[str | None] = [None] * len(body.link_names)
    spec = spec_of_links(mjcf_of_robot(robot, no_files, ""), body, link_surface(scene))
    add_self_contacts(spec, robot.hand)
    add_scene(
        spec, scene, environment_pieces(scene.environment_mesh, scene.way_bounds(), within=_reached(robot, scene))
    )
    return load_robot_model(str(spec.to_xml()), robot)


def load_robot_model(xml: str, robot: Robot) -> RobotModel:
    """Compile the `xml` of the model of the same robot, without cutting anything into pieces again.

    The object starts where the text has it, so that whoever plays the text alone begins alike.

    Raises:
        InputError: no such model, that of another robot, or one that names files.
    """
    try:
        _check_closed(xml)
        model = mujoco.MjModel.from_xml_string(xml)
        found = indexed(robot.body, model, xml, np.eye(4))
    except (ValueError, KeyError, ElementTree.ParseError) as error:
        raise InputError(
            f"the simulation's model is not that of {robot!r}: {error}; expected its links, joints and motors beside an "
            "object and surroundings; write it anew"
        ) from error
    (T_world_object,) = found.object_poses(model.qpos0[None])
    return RobotModel(robot, replace(found, T_world_object=T_world_object))


def _check_closed(xml: str) -> None:
    """Raise ValueError where a model would have MuJoCo open a file."""
    path = Path("the model")
    refuse_entities(xml, path)
    for element in ElementTree.fromstring(xml).iter():  # noqa: S314 - it has no entities
        names = [name for name, value in element.items() if name.startswith("file") and value]
        if element.tag == "include" or names:
            raise ValueError(f"<{element.tag} {' '.join(names)}> opens a file; expected all of it in the text")


def _reached(robot: Robot, scene: Scene) -> Float[np.ndarray, "2 3"]:
    """Return the corners of the box around what a stretched arm, or the hand on the object's way, can reach [m, world]."""
    reach = REACH + sum(float(np.linalg.norm(joint.origin[:3, 3])) for joint in robot.arm.tree.joints)
    way, base = scene.way_bounds(), robot.arm.T_world_base[:3, 3]
    return np.stack([np.minimum(way[0] - REACH, base - reach), np.maximum(way[1] + REACH, base + reach)])
