"""What an episode leaves in its folder: where everything was and what pressed, moment by moment, and how it ended."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError
from dexnudge.execution.grasp_and_lift import LIFT_PHASES
from dexnudge.geometry.rigid import ROUNDED_TOLERANCE
from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.jobs.archives import read_arrays
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.model import BASE_FORCE_LIMIT, BASE_TORQUE_LIMIT, SimulationModel
from dexnudge.simulation.rollout import Trace
from dexnudge.simulation.success import lasting_forces

ARRAYS, FIGURES = "episode.npz", "episode.json"
POSES = ("T_world_palm", "T_world_object")
SHOWN = ("time", "phase", "joint_names", "joint_angles", *POSES, "link_names", "link_force")
LARGEST = float(np.finfo(np.float32).max)  # of any number; datasets hold them in 32 bits


def write_arrays(
    folder: Path,
    simulation: SimulationModel,
    trace: Trace,
    *,
    T_world_palm: Float[np.ndarray, "record 4 4"],
    **further: Any,
) -> None:
    """Write episode.npz, an archive without pickles, of the trace, `further` arrays and the hand's own terms.

    These are joint_names, joint_angles and commanded_joint_angles (record, d) [rad], [m] of joints that slide: where the
    joints are, and what their motors aim at, which lies beyond what they press on. T_world_palm, T_world_object
    (record, 4, 4). link_names: of `Trace.link_force`.
    """
    np.savez_compressed(
        folder / ARRAYS,
        **vars(trace),
        joint_names=np.array(simulation.hand.joint_names),
        joint_angles=simulation.configurations(trace.qpos)[:, ROOT_COORDINATES:],
        commanded_joint_angles=trace.ctrl @ simulation.angle_of_motor.T,
        T_world_palm=T_world_palm,
        T_world_object=simulation.object_poses(trace.qpos),
        link_names=np.array(simulation.hand.link_names),
        **further,
    )


def read_episode(folder: Path, names: Sequence[str] = SHOWN) -> dict[str, np.ndarray]:
    """Return arrays of an episode.npz, trusting nothing in it; see `write_arrays` and `Trace`.

    names: of the arrays; those by which it can be looked at unless given.

    Raises:
        InputError: the file is missing, damaged, or its arrays do not fit together.
    """
    path = folder / ARRAYS
    arrays = read_arrays(
        path,
        folder="the folder of an episode that `dexnudge execute` wrote",
        content="what `dexnudge execute` wrote; execute again",
    )
    count, joints, links = (np.size(arrays.get(name, ())) for name in ("time", "joint_names", "link_names"))
    known: dict[str, tuple[str, tuple[int, ...]]] = {
        "time": ("f", (count,)),
        "phase": ("U", (count,)),
        "joint_names": ("U", (joints,)),
        **dict.fromkeys(("joint_angles", "commanded_joint_angles"), ("f", (count, joints))),
        **dict.fromkeys(POSES, ("f", (count, 4, 4))),
        "mocap": ("f", (count, 0 if np.shape(arrays.get("mocap", ()))[1:] == (0,) else 7)),
        "link_names": ("U", (links,)),
        "link_force": ("f", (count, links)),
    }
    for name in names:
        (kind, shape), array = known[name], arrays.get(name, np.zeros(0))
        finite = kind != "f" or array.dtype.kind != "f" or bool(np.abs(array).max(initial=0.0) <= LARGEST)
        if name not in arrays or not count or array.dtype.kind != kind or array.shape != shape or not finite:
            bad = "" if finite else ", with NaN, infinity or a number above 3e38"
            raise InputError(
                f"{path}: {name} is {array.dtype} of shape {array.shape}{bad}; expected finite values of shape {shape}; "
                "execute again"
            )
    if (np.diff(arrays["time"]) <= 0).any():
        raise InputError(f"{path}: time does not ascend; expected records one after another; execute again")
    for name in POSES:
        rotations = arrays[name][:, :3, :3]
        skew = np.abs(rotations.transpose(0, 2, 1) @ rotations - np.eye(3)).max()
        if not (skew <= ROUNDED_TOLERANCE and (np.linalg.det(rotations) > 0).all()):
            raise InputError(f"{path}: {name} holds what is no rotation; expected rigid poses; execute again")
    return {name: arrays[name] for name in names}


def forces_used(scene: Scene, simulation: SimulationModel, trace: Trace) -> dict[str, Any]:
    """Return what was pressed with, as JSON.

    link_force, link_force_peak: greatest normal force of each link on the object [N], mean over 0.1 s and over 20 ms.
    limits: on the former [N], and of the base's force [N] and torque [N m] along each axis. limits_used: greatest share of
    them; of motor_torque that of any motor at any step.
    """
    lasting, peak = lasting_forces(trace.time, trace.link_force), trace.link_force.max(axis=0)
    share = trace.torque_share.max(axis=0)
    base = share[simulation.base_motor]
    limits, used = {"link_force": scene.max_normal_force}, {"link_force": lasting.max() / scene.max_normal_force}
    if len(base):
        limits |= {"base_force": BASE_FORCE_LIMIT, "base_torque": BASE_TORQUE_LIMIT}
        used |= {"base_force": base[:3].max(), "base_torque": base[3:].max()}
    used["motor_torque"] = np.delete(share, simulation.base_motor).max(initial=0.0)
    return {
        "link_force": by_link(simulation, lasting),
        "link_force_peak": by_link(simulation, peak),
        "limits": limits,
        "limits_used": {name: round(float(value), 4) for name, value in used.items()},
    }


def forces_of_acts(simulation: SimulationModel, trace: Trace) -> dict[str, Any]:
    """Return slide_force and lift_force, those parts of `link_force` that belong to the slides and to the lifts [N]."""
    lifting = np.isin(trace.phase, LIFT_PHASES)[:, None]
    slid, lifted = (lasting_forces(trace.time, np.where(mine, trace.link_force, 0.0)) for mine in (~lifting, lifting))
    return {"slide_force": by_link(simulation, slid), "lift_force": by_link(simulation, lifted)}


def by_link(simulation: SimulationModel, force: Float[np.ndarray, " link"]) -> dict[str, float]:
    """Return the force of each link that has one [N], by its name."""
    return {simulation.hand.link_names[link]: round(float(force[link]), 4) for link in np.flatnonzero(force)}


def write_figures(folder: Path, outcome: Outcome, summary: dict[str, Any]) -> None:
    """Write episode.json: the summary of the episode, with the outcome by its name in `Outcome`."""
    text = json.dumps(summary | {"outcome": outcome.name}, indent=2, allow_nan=False)
    (folder / FIGURES).write_text(text + "\n", encoding="utf-8")
