"""plan.json read without trust.

Every key is of its kind, every number finite, no limit exceeded at any millisecond; phases are in order, and the object goes
along the scene's motion by the push's length.
"""

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float

from dexnudge.arms.arm import JointLimits
from dexnudge.errors import InputError, quote
from dexnudge.geometry.rigid import rigid_transform
from dexnudge.jobs.json_files import AT_LEAST_0, Must, from_fields, read_json_object
from dexnudge.scenes.scene import LONGEST_MOTION, Scene
from dexnudge.trajectories.interpolation import limits_used
from dexnudge.trajectories.plan import PHASES, JointTrajectory, Phase
from dexnudge.trajectories.plan_json import ARRAYS, FORMAT_VERSION, LIMITS

LARGEST_FILE = 2**26  # [bytes] 9 minutes of 23 joints every 10 ms
BEYOND = 1e-6  # [rad], [m] that a position may lie outside its limits, and in proportion that limits may differ
MOST_SHARE = 1.001  # of a limit that is used: rounding of times to 1 ns shakes the jerk by so much
AT_REST = 1e-6  # [rad/s], [m/s]
LONGEST = 600.0  # [s] of a plan
LONGEST_PIECE, SHORTEST_PIECE = 10.0, 1e-6  # [s] between two samples; the quintic is looked at every millisecond
AGAIN = "plan again, or take the file as it was written"


def _row(value: Any, where: str, length: int | None = None) -> Float[np.ndarray, " n"]:
    """Return a list of finite numbers."""
    if type(value) is not list or any(type(each) not in (int, float) for each in value):
        raise InputError(f"{where} is {quote(value)}; expected {'numbers' if length is None else f'{length} numbers'}")
    if length is not None and len(value) != length:
        raise InputError(f"{where} has {len(value)} numbers; expected {length}; {AGAIN}")
    try:
        row = np.array(value, dtype=float)
    except OverflowError as error:
        raise InputError(f"{where} holds an integer of too many digits; expected numbers; {AGAIN}") from error
    if not np.isfinite(row).all():
        raise InputError(f"{where} holds NaN or infinity; expected finite numbers; {AGAIN}")
    return row


def _limits(value: Any, where: str) -> Float[np.ndarray, " 5"]:
    """Return lower, upper, velocity, acceleration and jerk of a joint."""
    lower, upper, *rates = row = _row(value, where, len(LIMITS))
    if lower > upper:
        raise InputError(f"{where}: lower {lower:g} > upper {upper:g}; expected lower <= upper; {AGAIN}")
    for kind, rate in zip(LIMITS[2:], rates, strict=True):
        if rate <= 0:
            raise InputError(f"{where}: {kind} is {rate:g}; expected more than 0; {AGAIN}")
    return row


Row = Annotated[np.ndarray, _row]
Pose = Annotated[np.ndarray, partial(rigid_transform, unscaled="check the numbers")]


@dataclass(frozen=True, kw_only=True)
class PlanFile:
    """What a plan.json holds, docs/plan_format.md; `read_trajectory` and `read_phases` see whether it fits together."""

    arm: str
    hand: str
    joint_names: Annotated[tuple[str, ...], Must("a list of names", bool)]
    unit: Literal["rad"]
    units: Any = None
    length: Annotated[float, AT_LEAST_0]
    T_world_base: Pose
    flange: str
    mount: str
    T_flange_mount: Pose
    home: Row
    limits: dict[str, Annotated[np.ndarray, _limits]]
    scene: Any
    phases: Annotated[tuple[Phase, ...], Must("a list of objects", bool)]
    actuators: Any
    time: Row
    position: Any
    velocity: Any
    acceleration: Any
    effort: Any
    seconds: dict[str, Annotated[float, AT_LEAST_0]] = field(default_factory=dict)


def read_plan_json(path: Path) -> PlanFile:
    """Return what a plan.json holds.

    Raises:
        InputError: missing, too large, truncated, or what `plan_file` refuses.
    """
    expected = "the folder that Plan.save or `dexnudge plan` wrote, or its plan.json"
    again = f"it is truncated or damaged; {AGAIN}"
    content = read_json_object(
        path, error=InputError, expected=expected, again=again, constant=float, largest=LARGEST_FILE
    )
    return plan_file(content, path)


def plan_file(content: dict[str, Any], path: Path) -> PlanFile:
    """Return the content of a plan.json, every key of the right kind and the numbers finite.

    Raises:
        InputError: foreign, of a later version, or a value that no plan can have.
    """
    version = content.get("format_version")
    if type(version) is not int or version < 1 or "joint_names" not in content:
        raise InputError(
            f"{path}: format_version is {quote(version)}; expected the plan.json that Plan.save or `dexnudge plan` wrote"
        )
    if version > FORMAT_VERSION:
        raise InputError(
            f"{path} has format version {version}, from a later dexnudge; expected at most {FORMAT_VERSION}; update "
            "dexnudge, or plan again"
        )
    phases = content.get("phases")
    if isinstance(phases, list) and len(phases) > len(PHASES):
        raise InputError(f"{path}: phases has {len(phases):,} entries; expected at most {len(PHASES)}; {AGAIN}")
    plan = from_fields(content, PlanFile, str(path), error=InputError, again=AGAIN, others=True)
    names = plan.joint_names
    for what, wrong in (
        ("joint_names has {} twice; expected each joint once", [name for name in names if names.count(name) > 1]),
        (
            "limits of {} are missing; expected those of joint_names",
            [name for name in names if name not in plan.limits],
        ),
        ("limits of {} are there, of no joint of the plan", [name for name in plan.limits if name not in names]),
    ):
        if wrong:
            raise InputError(f"{path}: {what.format(', '.join(dict.fromkeys(wrong)))}; {AGAIN}")
    return replace(plan, limits={name: plan.limits[name] for name in names})


def read_trajectory(plan: PlanFile, path: Path) -> JointTrajectory:
    """Return the trajectory.

    Raises:
        InputError: arrays of other lengths, what is no finite number, times that do not increase from 0, a limit that is
            exceeded at a sample or between two, or a robot that moves at the start or the end; with the place.
    """
    names, time = plan.joint_names, plan.time
    if len(time) < 2 or time[0] != 0:
        raise InputError(f"{path}: time begins with {quote(time[:2].tolist())}; expected two samples or more from 0 s")
    late = np.flatnonzero(np.diff(time) <= 0)
    if len(late):
        raise InputError(
            f"{path}: time[{late[0] + 1}] is {time[late[0] + 1]} s, after {time[late[0]]} s; expected increasing times; "
            f"{AGAIN}"
        )
    if time[-1] > LONGEST:
        raise InputError(f"{path}: time ends with {time[-1]:g} s; expected at most {LONGEST:g} s; {AGAIN}")
    pieces = np.diff(time)
    for piece, what in ((pieces.argmax(), "at most"), (pieces.argmin(), "at least")):
        if not SHORTEST_PIECE <= pieces[piece] <= LONGEST_PIECE:
            bound = LONGEST_PIECE if what == "at most" else SHORTEST_PIECE
            raise InputError(
                f"{path}: time[{piece + 1}] is {pieces[piece]:g} s after the sample before it; expected {what} {bound:g} s; "
                f"{AGAIN}"
            )
    arrays = {name: _rows(getattr(plan, name), len(time), names, f"{path}: {name}") for name in ARRAYS[1:]}
    table = np.stack([*plan.limits.values()])
    position = arrays["position"]
    outside = np.argwhere((position < table[:, 0] - BEYOND) | (position > table[:, 1] + BEYOND))
    if len(outside):
        sample, joint = outside[0]
        raise InputError(
            f"{path}: position of '{names[joint]}' at {time[sample]:g} s is {position[sample, joint]:g}; expected it within "
            f"its limits {table[joint, 0]:g} to {table[joint, 1]:g}; {AGAIN}"
        )
    trajectory = JointTrajectory(time=time, **arrays)
    exceeded = [
        each for each in limits_used(trajectory, joint_limits(plan.limits), names).exceeded if each.share > MOST_SHARE
    ]
    if exceeded:
        worst = max(exceeded, key=lambda each: each.share)
        raise InputError(f"{path}: {worst}, between samples or at one; expected at most all of it; {AGAIN}")
    for place, when in ((0, "start"), (-1, "end")):
        moving = np.flatnonzero(np.abs(arrays["velocity"][place]) > AT_REST)
        if len(moving):
            speed, name = arrays["velocity"][place, moving[0]], names[moving[0]]
            raise InputError(f"{path}: velocity of '{name}' at the {when} is {speed:g}; expected 0, at rest; {AGAIN}")
    return trajectory


def joint_limits(
    limits: dict[str, Float[np.ndarray, " 5"]], effort: Float[np.ndarray, " n"] | None = None
) -> JointLimits:
    """Return limits as a `PlanFile` has them, with any effort if it is left out."""
    columns = dict(zip(LIMITS, np.array(list(limits.values())).reshape(-1, len(LIMITS)).T, strict=True))
    return JointLimits(**columns, effort=np.full(len(limits), np.inf) if effort is None else effort)


def _rows(value: Any, samples: int, names: tuple[str, ...], where: str) -> Float[np.ndarray, "k n"]:
    """Return a number for each sample and joint."""
    if type(value) is not list or len(value) != samples:
        got = f"{len(value)} rows" if isinstance(value, list) else quote(value)
        raise InputError(f"{where} is {got}; expected {samples} rows, one for each time; {AGAIN}")
    rows = [_row(row, f"{where}[{index}]", len(names)) for index, row in enumerate(value)]
    return np.stack(rows)


PUSHING = PHASES[:5]  # what every plan holds
SAME_PLACE = 1e-6  # [m], and of rotations' entries: the scene's files are rounded to 1e-9
STRONGEST = 1000.0  # [N] of a link; no hand presses so hard
FARTHEST = 0.5  # [m] from where the push should end to where the object is taken, or lifted to
AT_ONCE = 1e-9  # [s] between the end of a phase and the start of the next


def read_phases(plan: PlanFile, path: Path) -> tuple[Phase, ...]:
    """Return the phases; InputError for a gap between them, or a time outside the trajectory's."""
    phases, time = plan.phases, plan.time
    ends = [float(time[0]), *(phase.end for phase in phases)]
    for phase, before in zip(phases, ends, strict=False):
        if abs(phase.start - before) > AT_ONCE or phase.end < phase.start:
            raise InputError(
                f"{path}: phase '{phase.name}' is from {phase.start:g} to {phase.end:g} s; expected it to start at "
                f"{before:g} s, where what is before it ends, and to end later; {AGAIN}"
            )
    if abs(ends[-1] - time[-1]) > AT_ONCE:
        raise InputError(
            f"{path}: the phases end at {ends[-1]:g} s, the trajectory at {time[-1]:g} s; expected the same; {AGAIN}"
        )
    return phases


def check_phases(phases: tuple[Phase, ...], length: float, scene: Scene, where: str) -> None:
    """Refuse phases that are no push of the scene's object; `where` begins the message.

    Raises:
        InputError: a phase is missing, out of order or without duration, a force is out of range, or the object is
            elsewhere than `length` [m] of the scene's motion brings it.
    """
    names = tuple(phase.name for phase in phases)
    if names not in (PUSHING, PHASES):
        raise InputError(
            f"{where}: the phases are {quote(', '.join(names))}; expected {', '.join(PUSHING)}, and after them nothing or "
            f"{', '.join(PHASES[5:])}; {AGAIN}"
        )
    if not 0.0 < length <= LONGEST_MOTION:
        raise InputError(f"{where}: length is {length:g} m; expected more than 0, at most {LONGEST_MOTION:g}; {AGAIN}")
    here, there = scene.T_world_object, scene.T_world_object.copy()
    there[:3, 3] += length * scene.motion
    for phase in phases:
        if not phase.end > phase.start:
            raise InputError(
                f"{where}: phase '{phase.name}' is from {phase.start:g} to {phase.end:g} s; expected it to take time; "
                f"{AGAIN}"
            )
        for link, force in phase.link_force.items():
            if not 0.0 <= force <= STRONGEST:
                raise InputError(
                    f"{where}: link_force of '{link}' in phase '{phase.name}' is {force:g}; expected 0 to {STRONGEST:g} N; "
                    f"{AGAIN}"
                )
        expected = there if phase.name not in PUSHING[:3] else here
        off = np.abs(phase.T_world_object - expected)
        if phase.name in PUSHING and not off.max() <= SAME_PLACE:
            raise InputError(
                f"{where}: T_world_object of phase '{phase.name}' has the object {_at(phase.T_world_object)}; expected it "
                f"{_at(expected)}, turned as in the scene: a push by the length, {length:g} m, along the scene's motion; "
                f"{AGAIN}"
            )
        if not np.linalg.norm(off[:3, 3]) <= FARTHEST:
            raise InputError(
                f"{where}: T_world_object of phase '{phase.name}' has the object {_at(phase.T_world_object)}; expected it "
                f"at most {FARTHEST:g} m from {_at(there)}, where the push ends; {AGAIN}"
            )


def _at(pose: np.ndarray) -> str:
    return f"at {np.round(pose[:3, 3], 6).tolist()}"
