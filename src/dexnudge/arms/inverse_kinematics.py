"""Joint angles that bring an arm's flange to a pose, by differential inverse kinematics (mink, on MuJoCo)."""

from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.arms.arm import Arm
from dexnudge.hands.xml_text import numbers
from dexnudge.jobs.cached import cached_per_instance

POSITION_TOLERANCE = 1.0e-5  # [m]
ROTATION_TOLERANCE = 1.0e-4  # [rad]
MOST_STEPS = 40  # of one start; a start that leads anywhere takes 5 to 15
LARGEST_STEP = 0.5  # [rad] of any joint: the linear model holds no farther
ROTATION_COST = 0.3  # [m/rad] against the position's 1: the lever of a hand
POSTURE_COST = 1.0e-3  # keeps what the flange leaves free near the start
DAMPING = 1.0e-3  # of mink's Levenberg-Marquardt, in proportion to the squared error


class InverseKinematics:
    """Solves for the flange of one arm, where it stands; not for several threads."""

    def __init__(self, arm: Arm) -> None:
        import mink

        self.arm = arm
        self._mink = mink
        self._configuration = mink.Configuration(kinematic_model(arm))
        model = self._configuration.model
        self._frame = mink.FrameTask(arm.flange, "body", 1.0, ROTATION_COST, lm_damping=DAMPING)
        self._posture = mink.PostureTask(model, cost=POSTURE_COST)
        self._limits = [mink.ConfigurationLimit(model)]
        self._T_base_world = np.linalg.inv(arm.T_world_base)

    def solve(
        self, T_world_flange: Float[np.ndarray, "4 4"], start: Float[np.ndarray, " n"], *, most_steps: int = MOST_STEPS
    ) -> Float[np.ndarray, " n"] | None:
        """Return joint angles within their limits that bring the flange there, near `start`; None if none are found."""
        mink, configuration = self._mink, self._configuration
        configuration.update(np.clip(start, self.arm.limits.lower, self.arm.limits.upper))
        self._frame.set_target(mink.SE3.from_matrix(self._T_base_world @ T_world_flange))
        self._posture.set_target(np.asarray(start, dtype=float))
        for _ in range(most_steps):
            error = self._frame.compute_error(configuration)
            if np.abs(error[:3]).max() < POSITION_TOLERANCE and np.abs(error[3:]).max() < ROTATION_TOLERANCE:
                return np.array(configuration.q)
            try:
                step = mink.solve_ik(configuration, [self._frame, self._posture], 1.0, "daqp", limits=self._limits)
            except mink.NoSolutionFound:
                return None
            configuration.integrate_inplace(step * min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), 1e-9)), 1.0)
        return None

    def solutions(
        self, T_world_flange: Float[np.ndarray, "4 4"], *, starts: int, generator: np.random.Generator
    ) -> Iterator[Float[np.ndarray, " n"]]:
        """Yield solutions from home and from random joint angles, `starts` in all; some may be alike."""
        limits = self.arm.limits
        for number in range(starts):
            start = self.arm.home if number == 0 else generator.uniform(limits.lower, limits.upper)
            found = self.solve(T_world_flange, start)
            if found is not None:
                yield found


@cached_per_instance
def kinematic_model(arm: Arm) -> Any:
    """Return MuJoCo's model of the arm's links and joints, its base at the origin, without geometry."""
    model = ElementTree.Element("mujoco", model=arm.name)
    ElementTree.SubElement(model, "compiler", angle="radian", autolimits="true")
    bodies: dict[str, ElementTree.Element] = {}
    carrier = {joint.child: joint for joint in arm.tree.joints}
    for link in arm.tree.links:
        joint = carrier.get(link)
        if joint is None:
            bodies[link] = ElementTree.SubElement(ElementTree.SubElement(model, "worldbody"), "body", name=link)
        else:
            place = {
                "pos": numbers(joint.origin[:3, 3]),
                "quat": numbers(trimesh.transformations.quaternion_from_matrix(joint.origin)),
            }
            bodies[link] = ElementTree.SubElement(bodies[joint.parent], "body", place, name=link)
            if not joint.fixed:
                kind, ends = "slide" if joint.slides else "hinge", numbers([joint.lower, joint.upper])
                ElementTree.SubElement(
                    bodies[link], "joint", name=joint.name, type=kind, axis=numbers(joint.axis), range=ends
                )
        ElementTree.SubElement(bodies[link], "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(model, encoding="unicode"))
