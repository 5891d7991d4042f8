"""BODex's raw grasps, and the records that DexGraspBench judges: a hand at three moments, in the world.

BODex, `NAME_grasp.npy`: robot_pose (1, n, 3, 7 + d) of pregrasp, grasp and squeeze, joint_names (d), and obj_pose (1, 7), or
scene_path of a `scene.npy` that says where the object is. DexGraspBench, one `NNN.npy` for each grasp: pregrasp_qpos,
grasp_qpos, squeeze_qpos (7 + d), joint_names, obj_pose (7), obj_scale, and obj_path of a folder with the mesh and
`info/simplified.json`. A pose is position [m] and quaternion wxyz.

What is verified is the grasp; before it the fingers are 10 % nearer to the open hand, and the squeeze is as far beyond it,
within the joints' limits.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError
from dexnudge.formats.hand_poses import check_scale, checked_configurations, object_scale, palm_poses
from dexnudge.formats.object_arrays import read_object_array, write_object_array
from dexnudge.geometry.rigid import FARTHEST
from dexnudge.geometry.transforms import transform_configurations
from dexnudge.hands.export import obj_text
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.jobs.json_files import path_inside
from dexnudge.results.samples import Samples

STAGES = ("pregrasp", "grasp", "squeeze")
GRASP = 1  # of the stages
OPENING = 0.1  # of the way to the open hand
OBJECT = "object"
UNIT = 1e-3  # by which the length of a quaternion may be off: it was rounded


def write_bodex(samples: Samples, folder: Path, *, name: str) -> None:
    """Write NAME_grasp.npy, its scene.npy and the meshes."""
    scene = samples.scene
    stages = _stages(samples.hand, samples.q.astype(np.float64))
    parts = {OBJECT: (scene.object_mesh, scene.T_world_object), "environment": (scene.environment_mesh, np.eye(4))}
    bodies = {}
    for part, (mesh, pose) in parts.items():
        (folder / f"{part}.obj").write_text(obj_text(mesh), encoding="ascii")
        body = {"file_path": f"{part}.obj", "pose": _seven(pose[None])[0], "scale": np.ones(3)}
        bodies[part] = {"type": "rigid_object", "name": part, **body}
    written = {"scene_id": name, "scene": bodies, "task": {"type": "nudge", "obj_name": OBJECT}}
    write_object_array(folder / "scene.npy", written)
    record = {"robot_pose": stages.swapaxes(0, 1)[None], "joint_names": list(samples.hand.joint_names)}
    record |= {"scene_path": "scene.npy", "obj_pose": _seven(scene.T_world_object[None]), "obj_scale": np.ones(1)}
    write_object_array(folder / f"{name}_grasp.npy", record)


def write_dexgraspbench(samples: Samples, folder: Path, *, name: str) -> None:
    """Write a record for each sample into graspdata/NAME, and the object's folder."""
    scene, place = samples.scene, folder / OBJECT / name
    for kind in ("mesh", "info"):
        (place / kind).mkdir(parents=True)
    (place / "mesh" / "simplified.obj").write_text(obj_text(scene.object_mesh), encoding="ascii")
    solid = scene.object_mesh if scene.object_mesh.is_volume else scene.object_mesh.convex_hull
    info = {"mass": scene.mass, "density": scene.mass / float(solid.volume), "scale": 1.0}
    (place / "info" / "simplified.json").write_text(json.dumps(info, indent=2), encoding="utf-8")
    shared = {"schema_version": 1, "obj_path": f"{OBJECT}/{name}", "obj_scale": 1.0}
    shared |= {"obj_pose": _seven(scene.T_world_object[None])[0], "joint_names": list(samples.hand.joint_names)}
    for row, stages in enumerate(_stages(samples.hand, samples.q.astype(np.float64)).swapaxes(0, 1)):
        moments = {f"{stage}_qpos": moment for stage, moment in zip(STAGES, stages, strict=True)}
        write_object_array(folder / "graspdata" / name / f"{row:03d}.npy", shared | moments)


def read_bodex(content: dict[str, Any], hand: Hand, *, path: Path) -> Float[np.ndarray, "n coordinates"]:
    """Return the grasps of a BODex file in the object's frame.

    Raises:
        InputError: it is of another form, of another hand, or the scene that it names is not beside it.
    """
    where = str(path)
    poses = _array(content, "robot_pose", 4, where)
    if poses.shape[0] != 1 or poses.shape[2] < len(STAGES) or poses.shape[3] < 8:
        raise InputError(f"{where}: robot_pose has shape {poses.shape}; expected (1, n, 3, 7 + d)")
    if "obj_pose" in content:
        object_pose = _array(content, "obj_pose", 2, where)[0]
    else:
        object_pose = _pose_in_scene(content.get("scene_path"), path)
    return _in_object_frame(poses[0, :, GRASP], object_pose, content.get("joint_names"), hand, where)


def read_dexgraspbench(content: dict[str, Any], hand: Hand, *, where: str) -> Float[np.ndarray, "1 coordinates"]:
    """Return the grasp of a record in the object's frame; InputError where it is of another form."""
    grasp, object_pose = _array(content, "grasp_qpos", 1, where), _array(content, "obj_pose", 1, where)
    return _in_object_frame(grasp[None], object_pose, content.get("joint_names", hand.joint_names), hand, where)


def check_object_scale(content: dict[str, Any], radius: float, where: str) -> None:
    """Refuse a record whose obj_scale is neither 1, of a mesh in metres, nor as `check_scale` expects; InputError."""
    scale = object_scale(content.get("obj_scale", 1.0), where)
    if scale != 1.0:
        check_scale(scale, radius, where)


def _pose_in_scene(scene_path: Any, path: Path) -> np.ndarray:
    """Return the object's pose of the scene that a BODex file names."""
    file = path_inside(path.parent, scene_path, "scene_path", file=path.name, what="scene")
    content = read_object_array(file)
    try:
        body = content["scene"][content["task"]["obj_name"]]
    except (KeyError, TypeError, IndexError) as error:
        raise InputError(f"{file} is no scene of BODex ({error}); expected scene, and task with obj_name") from error
    return _array({"pose": body.get("pose")} if isinstance(body, dict) else {}, "pose", 1, str(file))


def _in_object_frame(rows: np.ndarray, object_pose: np.ndarray, names: Any, hand: Hand, where: str) -> np.ndarray:
    poses, (T_world_object,) = _matrices(rows[:, :7], where), _matrices(object_pose[None], where)
    q = checked_configurations(hand, poses, rows[:, 7:], names, where=where)
    return transform_configurations(np.linalg.inv(T_world_object), q)


def _array(content: dict[str, Any], key: str, dimensions: int, where: str) -> np.ndarray:
    try:
        array = np.asarray(content.get(key, 0.0))
    except ValueError as error:
        raise InputError(f"{where}: {key} has rows of different lengths; expected an array") from error
    if array.ndim != dimensions or array.dtype.kind not in "fiu" or not array.size or not np.isfinite(array).all():
        raise InputError(
            f"{where}: {key} is {array.dtype} of shape {array.shape}; expected finite numbers in {dimensions} dimensions"
        )
    return array.astype(np.float64)


def _stages(hand: Hand, q: Float[np.ndarray, "n coordinates"]) -> Float[np.ndarray, "stage n seven_and_joints"]:
    """Return pregrasp, grasp and squeeze as position, quaternion wxyz and joint angles."""
    found = []
    for share in (-OPENING, 0.0, OPENING):
        moved = q.copy()
        moved[:, ROOT_COORDINATES:] += share * (q[:, ROOT_COORDINATES:] - hand.apart)
        angles = (
            hand.clamp(torch.as_tensor(moved)).numpy()[:, ROOT_COORDINATES:] if share else moved[:, ROOT_COORDINATES:]
        )
        found.append(np.concatenate([_seven(palm_poses(q)), angles], axis=1))
    return np.stack(found)


def _seven(poses: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 7"]:
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(scalar_first=True)
    return np.concatenate([poses[:, :3, 3], quaternions], axis=1)


def _matrices(seven: Float[np.ndarray, "n seven"], where: str) -> Float[np.ndarray, "n 4 4"]:
    length = np.linalg.norm(seven[:, 3:], axis=1) if seven.shape[1] == 7 else np.zeros(1)
    if not (np.abs(length - 1.0) <= UNIT).all():
        raise InputError(
            f"{where}: a pose is no position and unit quaternion wxyz; expected 7 numbers, the last 4 of length 1"
        )
    if np.abs(seven[:, :3]).max() > FARTHEST:
        raise InputError(f"{where}: a pose is more than {FARTHEST:g} m away; expected metres")
    poses = np.tile(np.eye(4), (len(seven), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(seven[:, 3:], scalar_first=True).as_matrix()
    poses[:, :3, 3] = seven[:, :3]
    return poses
