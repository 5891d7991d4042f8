"""LeRobotDataset v3.0: executions as episodes, `data/chunk-000/file-000.parquet` and `meta/`, without videos.

observation.state: palm (position [m], quaternion wxyz) and joint angles; observation.environment_state: the object's pose,
likewise; action: what the base aims at, likewise (nothing of an arm's plan), and commanded joint angles. Frames are 20 ms
apart, each the record nearest in time; next.success is true at the end of an episode that succeeded.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError, quote, writing
from dexnudge.execution.episode_files import ARRAYS, FIGURES, POSES, read_episode
from dexnudge.jobs.json_files import read_json_object

FPS = 50  # records are 20 ms apart
UNEVEN = 1e-4  # [s] by which a record may be off; what LeRobot's loader tolerates
RECORDED = ("time", "joint_names", "joint_angles", "commanded_joint_angles", *POSES, "mocap")
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_MB, DATA_MB, CHUNK = 200, 100, 1000  # LeRobot's own limits on files; there is one file here
PLACE = {"chunk_index": 0, "file_index": 0}
STATISTICS: dict[str, Callable[..., np.ndarray]] = {"min": np.min, "max": np.max, "mean": np.mean, "std": np.std}
INDICES = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
CARD = """---
license: mit
task_categories: [robotics]
tags: [LeRobot, dexnudge]
configs:
- config_name: default
  data_files: data/*/*.parquet
---
Executions in MuJoCo, written by dexnudge {version}: a hand pushes, presses or hooks an object. `meta/info.json` names every
column.
"""


def write_lerobot(episodes: Path, folder: Path, *, task: str, robot: str, version: str) -> int:
    """Write every episode below `episodes` into a dataset; return how many there are.

    task: in words, the same of all. robot: name of the hand.

    Raises:
        InputError: no episodes, damaged ones, or those of different hands.
    """
    files = sorted(episodes.rglob(ARRAYS))
    if not files:
        raise InputError(f"{episodes} holds no {ARRAYS}; expected a folder that `dexnudge execute` wrote")
    parts = [_read_episode(file) for file in files]
    names = parts[0].pop("names")
    for file, part in zip(files[1:], parts[1:], strict=True):
        if part.pop("names") != names:
            raise InputError(f"{file} is of another hand than {files[0]}; expected one; convert them one by one")
    lengths = [len(part["timestamp"]) for part in parts]
    for number, (part, length) in enumerate(zip(parts, lengths, strict=True)):
        part |= {"frame_index": np.arange(length), "episode_index": np.full(length, number)}
        part |= {"index": sum(lengths[:number]) + np.arange(length), "task_index": np.zeros(length, dtype=np.int64)}
    features = {
        name: {"dtype": "bool" if name.startswith("next.") else "float32", "shape": [len(own)], "names": own}
        for name, own in names.items()
    } | {name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in INDICES.items()}
    columns = {name: np.concatenate([part[name] for part in parts]) for name in features}
    with writing(f"the dataset {folder}"):
        _write_table(folder / DATA.format(**PLACE), {name: _column(columns[name], features[name]) for name in features})
        _write_table(folder / "meta/episodes/chunk-000/file-000.parquet", _episode_rows(parts, lengths, task))
        _write_tasks(folder / "meta/tasks.parquet", task)
        info = {
            "codebase_version": "v3.0",
            "robot_type": robot,
            "total_episodes": len(parts),
            "total_frames": sum(lengths),
            "total_tasks": 1,
            "chunks_size": CHUNK,
            "data_files_size_in_mb": DATA_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": FPS,
            "splits": {"train": f"0:{len(parts)}"},
            "data_path": DATA,
            "video_path": None,
            "features": features,
        }
        for name, content in {"info": info, "stats": _statistics(columns)}.items():
            (folder / f"meta/{name}.json").write_text(json.dumps(content, indent=4) + "\n", encoding="utf-8")
        (folder / "README.md").write_text(CARD.format(version=version), encoding="utf-8")
    return len(parts)


def _read_episode(path: Path) -> dict[str, Any]:
    """Return the columns of an episode.npz, and `names`: what stands in each column that is a vector."""
    found = read_episode(path.parent, RECORDED)
    joints = [str(name) for name in found["joint_names"]]
    time = found["time"]
    if np.diff(time).max(initial=0.0) > 1 / FPS + UNEVEN:
        raise InputError(f"{path}: its records are over {1000 // FPS} ms apart; expected those of `dexnudge execute`")
    # A phase that ends between two frames ends with a record: each frame is the record nearest to it.
    at = time[0] + np.arange(1 + int((time[-1] - time[0] + UNEVEN) * FPS)) / FPS
    records = np.searchsorted((time[1:] + time[:-1]) / 2, at)
    found = {name: values if name == "joint_names" else values[records] for name, values in found.items()}
    target, angles = found["mocap"], found["joint_angles"]
    success = read_json_object(path.with_name(FIGURES), error=InputError).get("success")
    if not isinstance(success, bool):
        raise InputError(
            f"{path.with_name(FIGURES)}: success is {quote(success)}; expected true or false; execute again"
        )
    last = np.arange(len(at)) == len(at) - 1
    columns = {
        "observation.state": np.concatenate([_seven(found["T_world_palm"]), angles], axis=1),
        "observation.environment_state": _seven(found["T_world_object"]),
        "action": np.concatenate([target, found["commanded_joint_angles"]], axis=1),
        "next.done": last,
        "next.success": last & success,
        "timestamp": np.arange(len(at)) / FPS,
    }
    names = {
        "observation.state": [*(f"palm_{axis}" for axis in POSE), *joints],
        "observation.environment_state": [f"object_{axis}" for axis in POSE],
        "action": [*(f"palm_{axis}" for axis in POSE[: target.shape[1]]), *joints],
        "next.done": ["done"],
        "next.success": ["success"],
    }
    return {**columns, "names": names}


def _seven(poses: Float[np.ndarray, "record 4 4"]) -> Float[np.ndarray, "record 7"]:
    """Return position and quaternion wxyz; the quaternion does not jump between records."""
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(scalar_first=True)
    turned = np.einsum("ij,ij->i", quaternions[1:], quaternions[:-1]) < 0
    quaternions[1:] *= np.where(np.cumsum(turned) % 2, -1.0, 1.0)[:, None]
    return np.concatenate([poses[:, :3, 3], quaternions], axis=1)


def _column(values: np.ndarray, feature: dict[str, Any]) -> pa.Array:
    """Return scalars, or lists of fixed length, of the feature's type."""
    kind, (size,) = feature["dtype"], feature["shape"]
    flat = pa.array(values.reshape(-1), type=pa.bool_() if kind == "bool" else getattr(pa, kind)())
    return flat if size == 1 else pa.FixedSizeListArray.from_arrays(flat, size)


def _episode_rows(parts: list[dict[str, Any]], lengths: list[int], task: str) -> dict[str, Any]:
    ends = np.cumsum(lengths)
    rows: dict[str, Any] = {
        "episode_index": np.arange(len(parts)),
        "tasks": [[task]] * len(parts),
        "length": lengths,
        "dataset_from_index": ends - lengths,
        "dataset_to_index": ends,
    }
    for kind in ("data", "meta/episodes"):
        rows |= {f"{kind}/{name}": np.full(len(parts), number) for name, number in PLACE.items()}
    statistics = [_statistics(part) for part in parts]
    for name, figures in statistics[0].items():
        rows |= {f"stats/{name}/{figure}": [each[name][figure] for each in statistics] for figure in figures}
    return rows


def _statistics(columns: dict[str, np.ndarray]) -> dict[str, dict[str, list[float]]]:
    """Return min, max, mean, std and count of each column."""
    found = {}
    for name, values in columns.items():
        flat = values.reshape(len(values), -1).astype(np.float64)
        found[name] = {figure: of(flat, axis=0).tolist() for figure, of in STATISTICS.items()}
        found[name]["count"] = [len(values)]
    return found


def _write_tasks(path: Path, task: str) -> None:
    """Write the one task as pandas writes a table whose index is the task's text."""
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": stored, "metadata": None}
        for name, (kind, stored) in kinds.items()
    ]
    said = {"index_columns": ["task"], "column_indexes": [], "columns": columns, "pandas_version": "2.0.0"}
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": [task]})
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(said)}), path)


def _write_table(path: Path, columns: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), path)
