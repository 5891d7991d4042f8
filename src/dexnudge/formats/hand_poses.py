"""Hand poses as others write them, a palm pose and joint angles by name, as configurations of a hand."""

from collections import Counter
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError, SceneError, quote
from dexnudge.geometry.rigid import FARTHEST, real_numbers, rigid_transform
from dexnudge.hands.hand import Hand
from dexnudge.planning.hand_motion import palm_pose

SCALES = (
    2.0  # times that a scale may differ from the object's radius: meshes fill a unit ball, or a box of its diagonal
)


def object_scale(value: Any, where: str) -> float:
    """Return the scale of an object's mesh; InputError where it is no number above 0."""
    try:
        scale = float(real_numbers(value).item())
    except (TypeError, ValueError, OverflowError):
        scale = 0.0
    if not 0 < scale < np.inf:
        raise InputError(f"{where}: scale is {quote(value)}; expected a number above 0")
    return scale


def check_scale(scale: float, radius: float, where: str) -> None:
    """Refuse grasps of an object of another size; InputError.

    radius: of the scene's object around its origin [m].
    """
    if not 1 / SCALES <= scale / radius <= SCALES:
        raise InputError(
            f"{where}: the grasps are of an object at the scale {scale:g}, and the scene's reaches {radius:g} m from its "
            f"origin; expected about as much; make the scene with the object of the grasps, in metres"
        )


def configurations(
    hand: Hand, T_frame_palm: Any, joint_angles: Any, joint_names: Any, *, where: str
) -> tuple[Float[np.ndarray, "n coordinates"], dict[int, str]]:
    """Return q (n, 9 + d) in the frame of the poses, and what is wrong with invalid poses; their rows are NaN.

    T_frame_palm: (n, 4, 4) poses of the palm link [m]. joint_angles: (n, d) [rad], [m] of joints that slide.
    joint_names: (d,) in the order of joint_angles, the hand's joints in any order. where: begins the messages.

    Raises:
        InputError: arrays that do not fit together, or joints that are not the hand's.
    """
    columns = _columns(hand, joint_names, where)
    poses = _numbers(T_frame_palm, "T_world_palm", ("n", 4, 4), where)
    angles = _numbers(joint_angles, "joint_angles", ("n", len(columns)), where)
    if len(poses) != len(angles):
        raise InputError(f"{where}: {len(poses)} palm poses and {len(angles)} rows of joint angles; expected as many")
    q, wrong = np.full((len(poses), 9 + len(columns)), np.nan), {}
    for row, (given, joints) in enumerate(zip(poses, angles, strict=True)):
        try:
            pose = rigid_transform(given, "the palm's pose", unscaled="normalise the rotation")
        except SceneError as error:
            wrong[row] = str(error)
            continue
        if not (np.abs(joints) <= FARTHEST).all():
            wrong[row] = f"a joint angle is NaN, infinite or above {FARTHEST:g}; expected radians, or metres"
            continue
        q[row] = np.concatenate([pose[:3, 3], pose[:3, 0], pose[:3, 1], joints[columns]])
    return q, wrong


def checked_configurations(
    hand: Hand, T_frame_palm: Any, joint_angles: Any, joint_names: Any, *, where: str
) -> Float[np.ndarray, "n coordinates"]:
    """Return `configurations`; InputError also where one of them is none, or where there are none."""
    q, wrong = configurations(hand, T_frame_palm, joint_angles, joint_names, where=where)
    for row, what in wrong.items():
        raise InputError(f"{where}, pose {row}: {what}")
    if not len(q):
        raise InputError(f"{where} holds no poses; expected at least one")
    return q


def palm_poses(q: Float[np.ndarray, "n coordinates"]) -> Float[np.ndarray, "n 4 4"]:
    """Return the poses of the palm in the frame of q [m]."""
    return np.array([palm_pose(row) for row in q.astype(np.float64)]).reshape(-1, 4, 4)


def _columns(hand: Hand, names: Any, where: str) -> list[int]:
    """Return the place of each of the hand's joints among the names."""
    given = names.tolist() if isinstance(names, np.ndarray) else names
    if not isinstance(given, list | tuple) or not all(isinstance(name, str) for name in given):
        raise InputError(f"{where}: joint_names is {quote(given)}; expected a list of names")
    doubles = [name for name, count in Counter(given).items() if count > 1]
    missing = [name for name in hand.joint_names if name not in given]
    unknown = [name for name in given if name not in hand.joint_names]
    for kind, which in (("twice", doubles), ("not", missing), ("but", unknown)):
        if which:
            raise InputError(
                f"{where}: joint_names has {kind} {quote(', '.join(which))}; expected each joint of hand '{hand.name}' "
                f"once: {', '.join(hand.joint_names)}"
            )
    return [list(given).index(name) for name in hand.joint_names]


def _numbers(value: Any, name: str, shape: tuple[Any, ...], where: str) -> np.ndarray:
    expected = f"({', '.join(map(str, shape))})"
    try:
        array = real_numbers(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{where}: {name} is no array of numbers ({error}); expected shape {expected}") from error
    if array.size == 0:
        array = array.reshape(0, *shape[1:])
    if array.ndim != len(shape) or array.shape[1:] != shape[1:]:
        raise InputError(f"{where}: {name} has shape {array.shape}; expected {expected}")
    return array
