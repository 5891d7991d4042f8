"""plan.json: a plan's trajectory, phases, limits and frames as text.

Numbers of the trajectory are rounded to 1e-12 rad or m, 1e-9 of their derivatives [rad/s, rad/s^2], 1e-9 s and 1e-6 N m:
then the third derivative between two samples changes by less than 0.1 rad/s^3. No number leaves its limits by rounding.
"""

import json
from dataclasses import asdict
from typing import Any

import numpy as np

from dexnudge.arms.export import robot_actuators
from dexnudge.arms.robot import Robot
from dexnudge.jobs.provenance import versions
from dexnudge.trajectories.plan import JointTrajectory, Plan

FORMAT_VERSION = 1
DECIMALS = {"time": 9, "position": 12, "velocity": 9, "acceleration": 9, "effort": 6}
ARRAYS = tuple(DECIMALS)  # as plan.json calls them
LIMITS = ("lower", "upper", "velocity", "acceleration", "jerk")  # of a joint, in this order


def rounded(plan: Plan) -> JointTrajectory:
    """Return the trajectory with the numbers that the files hold."""
    limits, given = plan.robot.limits, plan.trajectory
    bounds = {
        "position": (limits.lower, limits.upper),
        "velocity": (-limits.velocity, limits.velocity),
        "acceleration": (-limits.acceleration, limits.acceleration),
    }
    values = {}
    for name, decimals in DECIMALS.items():
        exact = np.asarray(getattr(given, name), dtype=float)
        values[name] = np.round(exact, decimals) + 0.0  # turns -0.0 into 0.0
        if name in bounds:
            low, high = bounds[name]
            values[name] = np.where((values[name] < low) | (values[name] > high), exact, values[name])
    return JointTrajectory(**values)


def plan_text(plan: Plan, trajectory: JointTrajectory, *, scene: str | None) -> str:
    """Return the text of plan.json: a key a line, a sample a line.

    Args:
        plan: the plan.
        trajectory: its trajectory, as `rounded`.
        scene: path of the scene's folder relative to the file; None where there is none.
    """
    robot, limits = plan.robot, plan.robot.limits
    units = units_of(robot)
    head = {
        "format_version": FORMAT_VERSION,
        "arm": robot.arm.name,
        "hand": robot.hand.name,
        "joint_names": list(robot.joint_names),
        "unit": "rad",
        **({"units": units} if "m" in units else {}),
        "scene": scene,
        "length": plan.length,
        "T_world_base": robot.arm.T_world_base.tolist(),
        "flange": robot.flange,
        "mount": robot.mount,
        "T_flange_mount": robot.T_flange_mount.tolist(),
        "home": robot.arm.home.tolist(),
    }
    of_joint = np.stack([getattr(limits, name) for name in LIMITS], axis=1).tolist()
    lists = {
        "limits": dict(zip(robot.joint_names, of_joint, strict=True)),
        "phases": [asdict(phase) | {"T_world_object": phase.T_world_object.tolist()} for phase in plan.phases],
        "actuators": motors_of(robot),
        **{name: getattr(trajectory, name).tolist() for name in ARRAYS},
    }
    tail = {"seconds": plan.seconds, "versions": versions()}
    lines = [f"{json.dumps(key)}: {_json(value)}" for key, value in head.items()]
    lines += [f"{json.dumps(key)}: {_lines(value)}" for key, value in lists.items()]
    lines += [f"{json.dumps(key)}: {_json(value)}" for key, value in tail.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def units_of(robot: Robot) -> list[str]:
    """Return the unit of each joint: "m" of those that slide, "rad" of the others."""
    return ["m" if slides else "rad" for slides in robot.body.sliding]


def motors_of(robot: Robot) -> list[dict[str, Any]]:
    """Return the actuators of plan.json."""
    return [
        {"name": motor.name, "joints": motor.joints, "kp": motor.kp, "kv": motor.kv} for motor in robot_actuators(robot)
    ]


def _lines(values: Any) -> str:
    """Return a list or an object as JSON with an entry a line; numbers in one line."""
    if isinstance(values, dict):
        return "{\n" + ",\n".join(f"  {json.dumps(key)}: {_json(value)}" for key, value in values.items()) + "\n}"
    if all(isinstance(value, float) for value in values):
        return _json(values)
    return "[\n" + ",\n".join(f"  {_json(value)}" for value in values) + "\n]"


def _json(value: Any) -> str:
    return json.dumps(value, separators=(",", ":") if isinstance(value, list) else None)
