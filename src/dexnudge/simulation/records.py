"""What is recorded of a simulation, 20 ms apart."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.simulation.push_model import PushModel
from dexnudge.simulation.push_readings import hand_clearance, hand_object_forces


@dataclass(frozen=True, kw_only=True)
class Records:
    """Records of hand and object.

    Attributes:
        time [s].
        qpos, ctrl, mocap: MuJoCo's coordinates, motor targets, and target of the base (position, quaternion wxyz).
        object_pose: centre of mass [m, world], quaternion wxyz of the object's frame.
        base_pose: of the palm, position [m] and quaternion wxyz.
        hand_object_force: sums of the normal and of the tangential forces of hand on object [N].
        hand_environment_clearance: [m] between convex pieces, at most 50 mm, negative where they penetrate.
        hand_environment_depth: greatest depth by MuJoCo's contacts at any step since the record before [m].
    """

    time: Float[np.ndarray, " record"]
    qpos: Float[np.ndarray, "record nq"]
    ctrl: Float[np.ndarray, "record nu"]
    mocap: Float[np.ndarray, "record 7"]
    object_pose: Float[np.ndarray, "record 7"]
    base_pose: Float[np.ndarray, "record 7"]
    hand_object_force: Float[np.ndarray, "record 2"]
    hand_environment_clearance: Float[np.ndarray, " record"]
    hand_environment_depth: Float[np.ndarray, " record"]


def record_now(push: PushModel, deepest: float) -> dict[str, Any]:
    """One record of the state that `push.data` is in, by the names in `Records`; deepest: its hand_environment_depth [m]."""
    data, palm, free = push.data, push.palm_position, push.object_position
    return {
        "time": data.time,
        "qpos": np.array(data.qpos),
        "ctrl": np.array(data.ctrl),
        "mocap": np.concatenate([data.mocap_pos[0], data.mocap_quat[0]]),
        "object_pose": np.concatenate([data.xipos[push.object_body], data.qpos[free + 3 : free + 7]]),
        "base_pose": np.array(data.qpos[palm : palm + 7]),
        "hand_object_force": hand_object_forces(push),
        "hand_environment_clearance": hand_clearance(push),
        "hand_environment_depth": deepest,
    }
