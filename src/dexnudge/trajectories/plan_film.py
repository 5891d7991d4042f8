"""A plan as a film: what it intends, before anything is played in physics."""

import numpy as np
from jaxtyping import Float, Int

from dexnudge.execution.film import with_object_at
from dexnudge.simulation.hand_path import interpolated
from dexnudge.trajectories.interpolation import at
from dexnudge.trajectories.plan import Plan
from dexnudge.trajectories.plan_penetration import object_poses
from dexnudge.viewer.recording import Curve, Recording
from dexnudge.viewer.visual_scene import visual_scenes

FRAME_TIME = 0.04  # [s] between frames: 25 a second
SPEED_STEP = 1e-4  # [s] to either side of a moment, for the palm's speed: at rest it is 0


def film_of_plan(plan: Plan, *, title: str = "") -> Recording:
    """Return arm, hand and object through all phases, with the speed of the joints and of the palm.

    The object rests but where a phase ends with it elsewhere: there it goes along with the palm.
    """
    trajectory, robot = plan.trajectory, plan.robot
    ends = np.array([phase.end for phase in plan.phases])
    time = np.unique(np.concatenate([np.arange(trajectory.time[0], trajectory.time[-1], FRAME_TIME), ends]))
    joints, phase = at(trajectory, time), np.searchsorted(ends[:-1], time)
    names = [plan.phases[index].name for index in phase]
    objects = object_poses(plan, time, robot.palm_poses(joints.position))
    last_move = max((index for index, name in enumerate(names) if name == "push"), default=-1)
    frames = [
        with_object_at(frame, pose, moving=index <= last_move, length=plan.length)
        for index, (frame, pose) in enumerate(
            zip(visual_scenes(plan.scene, robot.body, robot.coordinates(joints.position)), objects, strict=True)
        )
    ]
    task = f"{1e3 * plan.length:.0f} mm in {trajectory.duration:.1f} s"
    subtitle = f"{robot.hand.name} on {robot.arm.name}, {plan.scene.name}: {task}"
    return Recording(frames, time, names, _charts(plan, time), title, subtitle)


def ends_of_phases(plan: Plan, film: Recording) -> Int[np.ndarray, " phase"]:
    """Return the frames at which the phases end."""
    return np.searchsorted(film.time, [phase.end - 1e-9 for phase in plan.phases])


def _charts(plan: Plan, time: Float[np.ndarray, " frame"]) -> dict[str, tuple[Curve, ...]]:
    arm, limits, joints = plan.robot.arm.num_joints, plan.robot.limits, at(plan.trajectory, time)
    speed = 100 * np.abs(joints.velocity) / limits.velocity
    effort = 100 * np.abs(interpolated(time, plan.trajectory.time, plan.trajectory.effort)) / limits.effort
    ahead, behind = (
        plan.robot.palm_poses(joints.position + step * joints.velocity)[:, :3, 3] for step in (SPEED_STEP, -SPEED_STEP)
    )
    moved = 1e3 * np.linalg.norm(ahead - behind, axis=1) / (2 * SPEED_STEP)

    def of_both(share: Float[np.ndarray, "frame n"]) -> tuple[Curve, ...]:
        parts = {"arm": share[:, :arm], "hand": share[:, arm:]}
        return tuple(Curve(name, "%", part.max(axis=1, initial=0.0)) for name, part in parts.items())

    return {
        "fastest joint, of its limit": of_both(speed),
        "palm's speed": (Curve("speed", "mm/s", moved),),
        "torque that presses, of its limit": of_both(effort),
    }
