"""A plan: one trajectory of arm and hand from home to the push and back, in phases."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import torch
from jaxtyping import Float

from dexnudge.arms.robot import Robot
from dexnudge.geometry.rigid import rigid_transform
from dexnudge.jobs.json_files import AT_LEAST_0, Must
from dexnudge.scenes.scene import Scene

if TYPE_CHECKING:
    from dexnudge.trajectories.plan_episode import PlanEpisode

PHASES = ("pre-contact", "contact", "squeeze", "push", "retreat", "regrasp", "lift")
"""Names in order; each phase is called after where it leads. The last two only with `then_grasp`."""
PLACES = range(10**6 + 1)  # among the samples of one scene


@dataclass(frozen=True)
class JointTrajectory:
    """Samples of n joints at increasing times; between two samples the quintic through their values.

    time: [s], from 0. position [rad], velocity [rad/s], acceleration [rad/s^2]: of joints that slide in metres. effort: what
    the joints' controllers add to what keeps them on their way [N m]: the forces with which the hand presses.
    """

    time: Float[np.ndarray, " k"]
    position: Float[np.ndarray, "k n"]
    velocity: Float[np.ndarray, "k n"]
    acceleration: Float[np.ndarray, "k n"]
    effort: Float[np.ndarray, "k n"]

    @property
    def duration(self) -> float:
        """From the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])


@dataclass(frozen=True)
class Phase:
    """A part of a plan.

    name: one of PHASES. start, end: [s]. configuration: place among the samples that were planned for. link_force: normal
    force with which each of the hand's links presses on the object [N]; empty where none does. T_world_object: where the
    object is at the end.
    """

    name: Annotated[str, Must(f"one of {', '.join(PHASES)}", PHASES.__contains__)]
    start: Annotated[float, AT_LEAST_0]
    end: Annotated[float, AT_LEAST_0]
    configuration: Annotated[int, Must(f"an integer of 0 to {PLACES[-1]}", PLACES.__contains__)]
    T_world_object: Annotated[Float[np.ndarray, "4 4"], rigid_transform]
    link_force: dict[str, Annotated[float, AT_LEAST_0]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """A trajectory of arm and hand that pushes the object of a scene.

    Attributes:
        robot: arm and hand.
        scene: the scene, with the object where it lies at the start.
        trajectory: of the robot's joints, in the order of `robot.joint_names`; it starts at rest and ends at rest.
        phases: one after another, without gaps.
        length: of the push [m].
        seconds: wall time of planning by stage.
    """

    robot: Robot
    scene: Scene
    trajectory: JointTrajectory
    phases: tuple[Phase, ...]
    length: float
    seconds: dict[str, float] = field(default_factory=dict)

    def film(self, path: Path | str, *, title: str = "") -> Path:
        """Write arm, hand and object through the phases: an animation (.gif), a strip of pictures (.png), a page (.html).

        The strip has a picture for the end of each phase, under it hand and object from near; the page plays in a browser.

        Raises:
            InputError: another suffix.
            OutputError: the file cannot be written.
        """
        from dexnudge.execution.film import save_film
        from dexnudge.trajectories.plan_film import ends_of_phases, film_of_plan

        film = film_of_plan(self, title=title)
        return save_film(film, path, moments=ends_of_phases(self, film))

    def save(self, path: Path | str, *, overwrite: bool = False, pictures: bool = True) -> None:
        """Write a folder for controllers, simulators and readers (docs/plan_format.md); what `load_plan` reads.

        Args:
            path: the folder to make; or a file that ends in .json: plan.json alone, for controllers.
            overwrite: replace a plan that stands there.
            pictures: draw plan.gif and plan.png, which takes some seconds; plan.html is always there.

        Raises:
            InputError: numbers that no controller may be given, not finite or outside the joints' limits, or phases that
                are no push.
            MeshError: MuJoCo cannot take the object or the surroundings.
            OutputError: `path` exists without `overwrite`, is no plan, or cannot be written.
        """
        from dexnudge.trajectories.plan_folder import save_plan

        save_plan(self, path, overwrite=overwrite, pictures=pictures)

    def execute(self) -> "PlanEpisode":
        """Play the plan out in MuJoCo by the motors of arm and hand; nothing else moves them.

        Raises:
            InputError: the phases are no push.
            MeshError: MuJoCo cannot take the object or the surroundings.
        """
        from dexnudge.trajectories.plan_episode import execute_plan

        return execute_plan(self)

    def __repr__(self) -> str:
        names = ", ".join(phase.name for phase in self.phases)
        return f"Plan of {self.robot!r} in '{self.scene.name}': {self.trajectory.duration:.1f} s, {names}"


UPRIGHT = 0.99  # cosine between a base's z-axis and the world's, from which on it stands on something


def below_base(plan: Plan) -> float:
    """Return how far arm and hand come below the plane that the base stands on [m]; 0 for one that does not stand upright.

    Of the samples' positions, by the hulls of all links that move.
    """
    robot, body = plan.robot, plan.robot.body
    if robot.arm.T_world_base[2, 2] < UPRIGHT:
        return 0.0
    poses = body.forward_kinematics(torch.as_tensor(robot.coordinates(plan.trajectory.position))).numpy()
    lowest, still = np.inf, {-1}
    for link, (parent, joint, mesh) in enumerate(zip(body.link_parent, body.joints, body.link_meshes, strict=True)):
        if int(parent) in still and (joint is None or joint.index is None):
            still.add(link)
        elif len(mesh.faces):
            heights = poses[:, link, 2, :3] @ mesh.convex_hull.vertices.T + poses[:, link, 2, 3:]
            lowest = min(lowest, float(heights.min()))
    return max(float(robot.arm.T_world_base[2, 3]) - lowest, 0.0)
