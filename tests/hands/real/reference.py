"""Forward kinematics of a description by MuJoCo, from the file itself and by nothing of ours."""

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np


class Reference:
    """MuJoCo's model of a URDF or MJCF file, and the joints that follow others in it."""

    def __init__(self, path: Path) -> None:
        self.follows: dict[str, tuple[str, float, float]] = {}  # name -> leader, multiplier, offset
        if path.suffix == ".urdf":
            self.model = self._of_urdf(path)
        else:
            self.model = mujoco.MjModel.from_xml_path(str(path))
            self._read_equalities()

    def _of_urdf(self, path: Path) -> mujoco.MjModel:
        """Joints and links alone: MuJoCo reads few kinds of meshes, merges what does not move, and knows no `mimic`."""
        robot = ElementTree.parse(path).getroot()  # noqa: S314 - of packages that we install
        for link in robot.findall("link"):
            for child in list(link):
                link.remove(child)
            inertial = ElementTree.SubElement(link, "inertial")
            ElementTree.SubElement(inertial, "mass", value="1")
            ElementTree.SubElement(inertial, "inertia", ixx="1", iyy="1", izz="1", ixy="0", ixz="0", iyz="0")
        for joint in robot.findall("joint"):
            mimic = joint.find("mimic")
            if mimic is not None:
                numbers = float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))
                self.follows[joint.get("name", "")] = (mimic.get("joint", ""), *numbers)
        for element in robot.findall("mujoco") + robot.findall("transmission") + robot.findall("gazebo"):
            robot.remove(element)
        options = ElementTree.SubElement(robot, "mujoco")
        ElementTree.SubElement(options, "compiler", fusestatic="false", discardvisual="false")
        # MuJoCo leaves the first link out: it stands for the world.
        roots = {link.get("name") for link in robot.findall("link")}
        roots -= {joint.find("child").get("link") for joint in robot.findall("joint")}
        ElementTree.SubElement(robot, "link", name="the world")
        mount = ElementTree.SubElement(robot, "joint", name="the mount", type="fixed")
        ElementTree.SubElement(mount, "parent", link="the world")
        ElementTree.SubElement(mount, "child", link=roots.pop())
        return mujoco.MjModel.from_xml_string(ElementTree.tostring(robot, encoding="unicode"))

    def _read_equalities(self) -> None:
        model = self.model
        for equality in range(model.neq):
            if model.eq_type[equality] == mujoco.mjtEq.mjEQ_JOINT:
                follower, leader = (model.joint(int(ids[equality])).name for ids in (model.eq_obj1id, model.eq_obj2id))
                assert not model.eq_data[equality, 2:5].any()
                assert not model.qpos0.any()
                self.follows[follower] = (leader, *model.eq_data[equality, 1::-1].tolist())

    def transforms(self, values: dict[str, float], bodies: list[str], palm: str) -> np.ndarray:
        """T_palm_body (body, 4, 4) where the independent joints have these values [rad or m], all others 0."""
        data = mujoco.MjData(self.model)
        for joint in range(self.model.njnt):
            name = self.model.joint(joint).name
            data.qpos[self.model.jnt_qposadr[joint]] = self._value(name, values)
        mujoco.mj_kinematics(self.model, data)
        world = np.tile(np.eye(4), (1 + len(bodies), 1, 1))
        for place, body in zip(world, [palm, *bodies], strict=True):
            place[:3, :3], place[:3, 3] = data.body(body).xmat.reshape(3, 3), data.body(body).xpos
        return np.linalg.inv(world[0]) @ world[1:]

    def _value(self, name: str, values: dict[str, float]) -> float:
        if name in self.follows:
            leader, multiplier, offset = self.follows[name]
            return multiplier * self._value(leader, values) + offset
        return values.get(name, 0.0)

    def below(self, palm: str) -> set[str]:
        """The palm and the bodies that hang from it."""
        found = set()
        for body in range(self.model.nbody):
            above = body
            while above and self.model.body(above).name != palm:
                above = int(self.model.body_parentid[above])
            if above:
                found.add(self.model.body(body).name)
        return found
