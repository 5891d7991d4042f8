"""The folder of a plan: what a controller, a simulator and a reader need of it, and nothing outside it.

plan.json    trajectory, phases, limits, frames (docs/plan_format.md)     plan.csv    time and positions
plan.mcap    the same for ROS 2                                           README.md   how to play it
robot/       arm and hand as robot.urdf and robot.xml, with meshes        scene/      as in a result folder
             world.xml: robot, object and surroundings for MuJoCo, as `execute` plays them
plan.html    to look at and to play                      plan.gif, plan.png   the same as pictures
"""

import csv
import io
import json
from pathlib import Path
from string import Template

import numpy as np

from dexnudge.arms.export import ROBOT_FILES, export_robot
from dexnudge.errors import OutputError, check_kind, check_path
from dexnudge.execution.film import write_film
from dexnudge.geometry.devices import own_modes
from dexnudge.jobs.atomic_files import replace_atomically
from dexnudge.jobs.folders import new_folder
from dexnudge.jobs.json_files import path_inside
from dexnudge.scenes.files import SCENE_FILES
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.robot_model import robot_model
from dexnudge.trajectories.mcap import write_mcap
from dexnudge.trajectories.plan import JointTrajectory, Plan, below_base
from dexnudge.trajectories.plan_film import ends_of_phases, film_of_plan
from dexnudge.trajectories.plan_json import plan_text, rounded
from dexnudge.trajectories.plan_reader import (
    check_phases,
    plan_file,
    read_phases,
    read_plan_json,
    read_trajectory,
)
from dexnudge.trajectories.robot_files import check_effort, check_joints, check_links, compare_limits, read_robot

PLAN, CSV, MCAP, README = "plan.json", "plan.csv", "plan.mcap", "README.md"
ROBOT, SCENE = "robot", "scene"  # folders
FILM, WORLD_XML = "plan", "world.xml"
PLAN_FILES = (
    *(CSV, MCAP, README, f"{FILM}.html", f"{FILM}.gif", f"{FILM}.png", f"{ROBOT}/{WORLD_XML}"),
    *(f"{ROBOT}/{file}" for file in ROBOT_FILES),
    *(f"{SCENE}/{file}" for file in SCENE_FILES),
)
"""What a plan's folder consists of beside plan.json, as patterns of paths."""
TEMPLATE = Path(__file__).with_name("plan_readme.md")


@own_modes()
def save_plan(plan: Plan, path: Path | str, *, overwrite: bool = False, pictures: bool = True) -> None:
    """Write a plan's folder, or plan.json alone where `path` ends in .json; see `Plan.save`.

    Raises:
        InputError: numbers that no controller may be given, not finite or outside the joints' limits, or phases that are
            no push.
        MeshError: MuJoCo cannot take the object or the surroundings.
        OutputError: `path` exists without `overwrite`, is no plan, or cannot be written.
    """
    check_kind("plan", plan, Plan, "that of dn.load_plan")
    check_path("path", path, OutputError)
    path = Path(path)
    if path.suffix == ".json":
        text = plan_text(plan, rounded(plan), scene=None)
        _check(text, path, plan)
        if path.exists() and not overwrite:
            raise OutputError(
                f"{path} exists; expected a new file; choose another `path`, or replace it with `overwrite`"
            )
        with replace_atomically(path) as file:
            file.write_text(text, encoding="utf-8")
        return
    with new_folder(path, overwrite=overwrite, marker=PLAN, ours=PLAN_FILES, argument="path") as folder:
        write_plan(plan, folder, pictures=pictures)


def write_plan(plan: Plan, folder: Path, *, pictures: bool = True) -> None:
    """Write a plan's files into an empty folder; raises what `save_plan` does."""
    trajectory = rounded(plan)
    text = plan_text(plan, trajectory, scene=SCENE)
    _check(text, Path(PLAN), plan)  # the folder has another name until it is whole
    (folder / PLAN).write_text(text, encoding="utf-8")
    plan.scene.save(folder / SCENE)
    export_robot(plan.robot, folder / ROBOT)
    start = np.asarray(trajectory.position[0])
    (folder / ROBOT / WORLD_XML).write_text(robot_model(plan.robot, plan.scene).xml_at(start), encoding="utf-8")
    (folder / CSV).write_text(csv_text(plan.robot.joint_names, trajectory), encoding="utf-8")
    write_mcap(plan, trajectory, folder / MCAP)
    (folder / README).write_text(_readme(plan), encoding="utf-8")
    film = film_of_plan(plan, title="plan")
    write_film(film, folder, name=FILM, pictures=pictures, moments=ends_of_phases(plan, film))


def _check(text: str, path: Path, plan: Plan) -> None:
    """Refuse what `load_plan` would refuse."""
    file = plan_file(json.loads(text), path)
    trajectory, phases = read_trajectory(file, path), read_phases(file, path)
    check_links(phases, plan.robot.hand.link_names, path)
    check_phases(phases, file.length, plan.scene, str(path))
    check_effort(trajectory, plan.robot, path)


@own_modes()
def load_plan(path: Path | str) -> Plan:
    """Read a plan's folder, given itself or by its plan.json, trusting nothing in it.

    Raises:
        InputError: a file is missing, damaged, of another plan or a later version, or holds what no plan can; the message
            says where.
    """
    check_path("path", path)
    file = Path(path)
    file = file / PLAN if file.is_dir() else file
    content = read_plan_json(file)
    check_joints(content.joint_names, file.parent / ROBOT, file)
    compare_limits(content.limits, file.parent / ROBOT, file)
    trajectory, phases = read_trajectory(content, file), read_phases(content, file)
    robot = read_robot(file.parent / ROBOT, content, file)
    check_links(phases, robot.hand.link_names, file)
    check_effort(trajectory, robot, file)
    scene = Scene.load(path_inside(file.parent, content.scene, "scene", file=PLAN, what="scene"))
    check_phases(phases, content.length, scene, str(file))
    return Plan(robot, scene, trajectory, phases, content.length, content.seconds)


def csv_text(joint_names: tuple[str, ...], trajectory: JointTrajectory) -> str:
    """Return the text of plan.csv: time [s] and the joints' positions [rad], [m] of those that slide."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time", *joint_names])
    writer.writerows(
        [time, *row] for time, row in zip(trajectory.time.tolist(), trajectory.position.tolist(), strict=True)
    )
    return text.getvalue()


def _readme(plan: Plan) -> str:
    robot, arm = plan.robot, plan.robot.arm
    phases = [f"| {phase.name} | {phase.start:.2f} | {phase.end:.2f} |" for phase in plan.phases]
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        arm=arm.name,
        hand=robot.hand.name,
        scene=plan.scene.name,
        length=f"{1e3 * plan.length:.0f}",
        duration=f"{plan.trajectory.duration:.1f}",
        samples=len(plan.trajectory.time),
        joints=len(robot.joint_names),
        arm_joints=", ".join(robot.joint_names[: arm.num_joints]),
        hand_joints=", ".join(robot.joint_names[arm.num_joints :]),
        base=", ".join(f"{value:.3f}" for value in arm.T_world_base[:3, 3]),
        below=f"arm and hand come {100 * below_base(plan):.0f} cm below the plane of the base",
        phases="\n".join(phases),
    )
