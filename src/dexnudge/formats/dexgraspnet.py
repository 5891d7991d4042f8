"""DexGraspNet: `dataset/CODE.npy`, a list of {qpos, scale}, beside `meshdata/CODE/coacd/decomposed.obj`.

qpos names every coordinate: WRJTx, WRJTy, WRJTz [m] and WRJRx, WRJRy, WRJRz, Euler angles of fixed axes x, y, z [rad], of
the palm in the object's frame, and the joints [rad]. The mesh fills the unit ball; times `scale` it is in metres.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError, quote
from dexnudge.formats.hand_poses import check_scale, checked_configurations, object_scale, palm_poses
from dexnudge.formats.object_arrays import write_object_array
from dexnudge.geometry.rigid import real_numbers
from dexnudge.geometry.transforms import transform_configurations
from dexnudge.hands.export import obj_text
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.objects.sets import DEXGRASPNET_MESH
from dexnudge.results.samples import Samples

TRANSLATION, ROTATION = ("WRJTx", "WRJTy", "WRJTz"), ("WRJRx", "WRJRy", "WRJRz")
SAME_SCALE = 1e-6


def their_joint_names(hand: Hand) -> list[str]:
    """Return the joints as DexGraspNet names them: its Shadow Hand counts them from zero; others keep their names."""
    if hand.name != "shadow_full":
        return list(hand.joint_names)
    return [re.sub(r"J(\d)$", lambda found: f"J{int(found[1]) - 1}", f"robot0:{name}") for name in hand.joint_names]


def write_dexgraspnet(samples: Samples, folder: Path, *, name: str) -> None:
    """Write the samples, in their order, and the object's mesh."""
    scene = samples.scene
    q = transform_configurations(np.linalg.inv(scene.T_world_object), samples.q.astype(np.float64))
    scale = float(np.linalg.norm(scene.object_mesh.vertices, axis=1).max())
    euler = Rotation.from_matrix(palm_poses(q)[:, :3, :3]).as_euler("xyz")
    rows = np.concatenate([q[:, :3], euler, q[:, ROOT_COORDINATES:]], axis=1)
    names = [*TRANSLATION, *ROTATION, *their_joint_names(samples.hand)]
    entries = [{"qpos": dict(zip(names, row, strict=True)), "scale": scale} for row in rows.tolist()]
    write_object_array(folder / "dataset" / f"{name}.npy", entries)
    mesh = scene.object_mesh.copy()
    mesh.apply_scale(1.0 / scale)
    path = folder / "meshdata" / name / DEXGRASPNET_MESH
    path.parent.mkdir(parents=True)
    path.write_text(obj_text(mesh), encoding="ascii")


def read_dexgraspnet(
    content: Any, hand: Hand, *, where: str, scale: float | None = None, radius: float | None = None
) -> Float[np.ndarray, "n coordinates"]:
    """Return the hands of a file's entries in the object's frame.

    scale: take the entries of this one; None where all have the same. radius: see `check_scale`.

    Raises:
        InputError: an entry of another form, joints of another hand, numbers that are no pose, several scales, or one that
            does not fit the radius.
    """
    names = [*TRANSLATION, *ROTATION]
    rows, joints = [], dict(zip(their_joint_names(hand), hand.joint_names, strict=True))
    for index, entry in enumerate(content):
        qpos = entry.get("qpos") if isinstance(entry, dict) else None
        if not isinstance(qpos, dict) or not all(name in qpos for name in names):
            raise InputError(
                f"{where}, entry {index} is {quote(entry)}; expected qpos with {', '.join(names)} and joints"
            )
        rows.append((object_scale(entry.get("scale"), f"{where}, entry {index}"), qpos))
    scales = sorted({round(each, 9) for each, _ in rows})
    if scale is None and len(scales) > 1:
        listed = ", ".join(f"{each:g}" for each in scales)
        raise InputError(f"{where} has grasps of the object at the scales {listed}; expected one; name it as `scale`")
    chosen = [qpos for own, qpos in rows if scale is None or abs(own - scale) < SAME_SCALE]
    if not rows:
        raise InputError(f"{where} holds no grasps; expected at least one")
    if not chosen:
        listed = ", ".join(f"{each:g}" for each in scales)
        raise InputError(f"{where} has nothing at the scale {scale:g}; expected one of {listed}")
    if radius is not None:
        check_scale(scales[0] if scale is None else scale, radius, where)
    theirs = [name for name in chosen[0] if name not in names]
    if any(set(qpos) != {*names, *theirs} for qpos in chosen):
        raise InputError(f"{where}: its entries name different joints; expected those of one hand")
    try:
        numbers = [[qpos[name] for name in [*names, *theirs]] for qpos in chosen]
        values = real_numbers(numbers).reshape(len(chosen), len(names) + len(theirs))
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{where}: a coordinate is no number ({error}); expected metres and radians") from error
    places, angles = values[:, : len(names)], values[:, len(names) :]
    if not np.isfinite(places).all():
        raise InputError(f"{where} holds NaN or infinity; expected finite numbers")
    poses = np.tile(np.eye(4), (len(chosen), 1, 1))
    poses[:, :3, 3], poses[:, :3, :3] = places[:, :3], Rotation.from_euler("xyz", places[:, 3:]).as_matrix()
    return checked_configurations(hand, poses, angles, [joints.get(name, name) for name in theirs], where=where)
