"""plan.json read without trust.

Every key is of its kind, every number finite, no limit exceeded at any millisecond; phases are in order, and the object goes
along the scene's motion by the push's length.
"""

import json
import stat
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.arms.arm import JointLimits
from dexnudge.errors import InputError, quote
from dexnudge.geometry.rigid import rigid_transform
from dexnudge.jobs.json_files import unique_keys
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


def read_plan_json(path: Path) -> dict[str, Any]:
    """Return what a plan.json holds, as `parse_plan_json` does.

    Raises:
        InputError: missing, too large, or what `parse_plan_json` refuses.
    """
    try:
        found = path.stat()
        if not stat.S_ISDIR(found.st_mode) and not stat.S_ISREG(found.st_mode):
            raise InputError(f"{path} is no file; expected the plan.json that Plan.save or `dexnudge plan` wrote")
        if found.st_size > LARGEST_FILE:
            raise InputError(
                f"{path} has {found.st_size >> 20} MiB; expected at most {LARGEST_FILE >> 20} MiB; {AGAIN}"
            )
        text = path.read_text(encoding="utf-8")
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError) as error:
        raise InputError(
            f"{path}: no such file; expected the folder that Plan.save or `dexnudge plan` wrote, or its plan.json"
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is truncated or damaged ({error}); expected JSON; {AGAIN}") from error
    return parse_plan_json(text, path)


def parse_plan_json(text: str, path: Path) -> dict[str, Any]:
    """Return what the text of a plan.json holds, every key of the right kind and the numbers finite.

    Raises:
        InputError: truncated, foreign, of a later version, or a value that no plan can have.
    """
    try:
        content = json.loads(text, object_pairs_hook=unique_keys)
    except (ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"{path} is truncated or damaged ({error}); expected JSON; {AGAIN}") from error
    if not isinstance(content, dict):
        raise InputError(f"{path} holds a JSON {type(content).__name__}; expected an object; {AGAIN}")
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
    required = ("arm", "hand", "unit", "length", "T_world_base", "flange", "mount", "T_flange_mount", "home", "limits")
    missing = [key for key in (*required, "scene", "phases", "actuators", *ARRAYS) if key not in content]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}; expected all keys of a plan; {AGAIN}")
    _check_names(content["joint_names"], path)
    for key in ("arm", "hand", "flange", "mount"):
        if not isinstance(content[key], str):
            raise InputError(f"{path}: {key} is {quote(content[key])}; expected a name; {AGAIN}")
    if content["unit"] != "rad":
        raise InputError(f"{path}: unit is {quote(content['unit'])}; expected 'rad'; {AGAIN}")
    for key in ("T_world_base", "T_flange_mount"):
        content[key] = rigid_transform(content[key], f"{path}: {key}", unscaled="check the numbers")
    content["length"] = number(content["length"], f"{path}: length", "at least 0")
    seconds = content.get("seconds", {})
    if not isinstance(seconds, dict):
        raise InputError(f"{path}: seconds is {quote(seconds)}; expected an object; {AGAIN}")
    content["seconds"] = {key: number(value, f"{path}: seconds of {key!r}") for key, value in seconds.items()}
    content["home"] = _row(content["home"], None, f"{path}: home")
    return content


def _check_names(names: Any, path: Path) -> None:
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise InputError(f"{path}: joint_names is {quote(names)}; expected a list of names; {AGAIN}")
    doubles = sorted({name for name in names if names.count(name) > 1})
    if doubles:
        raise InputError(f"{path}: joint_names has {', '.join(doubles)} twice; expected each joint once; {AGAIN}")


def read_limits(content: dict[str, Any], path: Path) -> dict[str, Float[np.ndarray, " 5"]]:
    """Return lower, upper, velocity, acceleration and jerk of each joint.

    Raises:
        InputError: of a joint they are missing, not finite, reversed or not positive, or a joint is not the plan's.
    """
    limits, names = content["limits"], content["joint_names"]
    if not isinstance(limits, dict):
        raise InputError(f"{path}: limits is {quote(limits)}; expected an object; {AGAIN}")
    for kind, wrong in (
        ("are missing", [name for name in names if name not in limits]),
        ("are there, of no joint of the plan", [name for name in limits if name not in names]),
    ):
        if wrong:
            raise InputError(f"{path}: limits of {', '.join(wrong)} {kind}; expected those of joint_names; {AGAIN}")
    found = {}
    for name in names:
        where = f"{path}: limits of '{name}'"
        lower, upper, *rates = found[name] = _row(limits[name], len(LIMITS), where)
        if lower > upper:
            raise InputError(f"{where}: lower {lower:g} > upper {upper:g}; expected lower <= upper; {AGAIN}")
        for kind, rate in zip(LIMITS[2:], rates, strict=True):
            if rate <= 0:
                raise InputError(f"{where}: {kind} is {rate:g}; expected more than 0; {AGAIN}")
    return found


def read_trajectory(content: dict[str, Any], limits: dict[str, Float[np.ndarray, " 5"]], path: Path) -> JointTrajectory:
    """Return the trajectory.

    Raises:
        InputError: arrays of other lengths, what is no finite number, times that do not increase from 0, a limit that is
            exceeded at a sample or between two, or a robot that moves at the start or the end; with the place.
    """
    names = content["joint_names"]
    time = _row(content["time"], None, f"{path}: time")
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
    arrays = {name: _rows(content[name], len(time), names, f"{path}: {name}") for name in ARRAYS[1:]}
    table = np.stack([limits[name] for name in names])
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
        each for each in limits_used(trajectory, joint_limits(limits), names).exceeded if each.share > MOST_SHARE
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
    """Return limits as `read_limits` has them, with any effort if it is left out."""
    columns = dict(zip(LIMITS, np.array(list(limits.values())).reshape(-1, len(LIMITS)).T, strict=True))
    return JointLimits(**columns, effort=np.full(len(limits), np.inf) if effort is None else effort)


def number(value: Any, where: str, expected: str = "at least 0") -> float:
    """Return a number of 0 or more."""
    (found,) = _row([value], 1, where).tolist()
    if found < 0:
        raise InputError(f"{where} is {found:g}; expected {expected}; {AGAIN}")
    return float(found)


def _row(value: Any, length: int | None, where: str) -> Float[np.ndarray, " n"]:
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


def _rows(value: Any, samples: int, names: list[str], where: str) -> Float[np.ndarray, "k n"]:
    """Return a number for each sample and joint."""
    if type(value) is not list or len(value) != samples:
        got = f"{len(value)} rows" if isinstance(value, list) else quote(value)
        raise InputError(f"{where} is {got}; expected {samples} rows, one for each time; {AGAIN}")
    rows = [_row(row, len(names), f"{where}[{index}]") for index, row in enumerate(value)]
    return np.stack(rows)


PUSHING = PHASES[:5]  # what every plan holds
SAME_PLACE = 1e-6  # [m], and of rotations' entries: the scene's files are rounded to 1e-9
STRONGEST = 1000.0  # [N] of a link; no hand presses so hard
FARTHEST = 0.5  # [m] from where the push should end to where the object is taken, or lifted to
AT_ONCE = 1e-9  # [s] between the end of a phase and the start of the next
MOST_CONFIGURATIONS = 10**6  # samples of one scene that are planned for


def read_phases(content: dict[str, Any], time: Float[np.ndarray, " k"], path: Path) -> tuple[Phase, ...]:
    """Return the phases.

    Raises:
        InputError: an unknown name, a gap, a time outside the trajectory's, or a force below 0.
    """
    entries = content["phases"]
    if not isinstance(entries, list) or not entries or not all(isinstance(each, dict) for each in entries):
        raise InputError(f"{path}: phases is {quote(entries)}; expected a list of objects; {AGAIN}")
    phases = [_phase(each, f"{path}: phases[{index}]") for index, each in enumerate(entries)]
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
    return tuple(phases)


def _phase(entry: dict[str, Any], where: str) -> Phase:
    missing = [key for key in Phase.__dataclass_fields__ if key not in entry]
    if missing:
        raise InputError(f"{where} lacks {', '.join(missing)}; expected {', '.join(Phase.__dataclass_fields__)}")
    if entry["name"] not in PHASES:
        raise InputError(f"{where} is called {quote(entry['name'])}; expected one of {', '.join(PHASES)}")
    place = entry["configuration"]
    if type(place) is not int or not 0 <= place <= MOST_CONFIGURATIONS:
        raise InputError(
            f"{where}: configuration is {quote(place)}; expected an integer of 0 to {MOST_CONFIGURATIONS}; {AGAIN}"
        )
    forces = entry["link_force"]
    if not isinstance(forces, dict):
        raise InputError(f"{where}: link_force is {quote(forces)}; expected an object of links and newtons")
    return Phase(
        name=entry["name"],
        start=number(entry["start"], f"{where}: start"),
        end=number(entry["end"], f"{where}: end"),
        configuration=place,
        T_world_object=rigid_transform(entry["T_world_object"], f"{where}: T_world_object"),
        link_force={name: number(force, f"{where}: link_force of '{name}'") for name, force in forces.items()},
    )


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
