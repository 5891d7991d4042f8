"""A plan's phases, read without trust: in order, and the object goes along the scene's motion by the push's length."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError, quote
from dexnudge.geometry.rigid import rigid_transform
from dexnudge.scenes.scene import LONGEST_MOTION, Scene
from dexnudge.trajectories.plan import PHASES, Phase
from dexnudge.trajectories.plan_reader import AGAIN, number

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
