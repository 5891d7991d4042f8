"""An execution as a LeRobotDataset v3.0: the layout, names and types that LeRobot's documentation and loader state."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import trimesh

from dexnudge.errors import InputError
from dexnudge.formats.lerobot import write_lerobot

# huggingface/lerobot, src/lerobot/datasets/feature_utils.py (DatasetInfo) and dataset_metadata.py (episodes), v3.0
INFO_KEYS = {
    *(
        "codebase_version",
        "fps",
        "features",
        "total_episodes",
        "total_frames",
        "total_tasks",
        "chunks_size",
        "robot_type",
    ),
    *("data_files_size_in_mb", "video_files_size_in_mb", "data_path", "video_path", "splits"),
}
DEFAULT_FEATURES = {
    "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    **{
        name: {"dtype": "int64", "shape": [1], "names": None}
        for name in ("frame_index", "episode_index", "index", "task_index")
    },
}
EPISODE_COLUMNS = {
    *(
        "episode_index",
        "tasks",
        "length",
        "dataset_from_index",
        "dataset_to_index",
        "data/chunk_index",
        "data/file_index",
    ),
    *("meta/episodes/chunk_index", "meta/episodes/file_index"),
}
RECORDS = 30


def write_episode(folder, *, seed=0, success=True, joints=("FFJ4", "FFJ3"), records=RECORDS, **changes):
    generator = np.random.default_rng(seed)
    palms = np.stack([trimesh.transformations.rotation_matrix(0.3 * k, (0, 1, 0)) for k in range(records)])
    palms[:, :3, 3] = generator.normal(size=(records, 3))
    arrays = {
        "time": 0.02 * np.arange(records),
        "joint_names": np.array(joints),
        "joint_angles": generator.normal(size=(records, len(joints))),
        "commanded_joint_angles": generator.normal(size=(records, len(joints))),
        "T_world_palm": palms,
        "T_world_object": np.tile(np.eye(4), (records, 1, 1)),
        "mocap": generator.normal(size=(records, 7)),
    } | changes
    folder.mkdir(parents=True)
    np.savez_compressed(folder / "episode.npz", **arrays)
    (folder / "episode.json").write_text(json.dumps({"success": success}))
    return arrays


@pytest.fixture
def dataset(tmp_path):
    first = write_episode(tmp_path / "run/configuration_000", seed=1)
    second = write_episode(tmp_path / "run/configuration_001", seed=2, success=False, records=20)
    out = tmp_path / "out"
    out.mkdir()
    assert write_lerobot(tmp_path / "run", out, task="push it", robot="shadow_lite", version="0") == 2
    return out, (first, second)


def test_info_says_what_the_files_hold(dataset):
    out, _ = dataset
    info = json.loads((out / "meta/info.json").read_text())
    assert set(info) == INFO_KEYS
    assert (info["codebase_version"], info["fps"], info["splits"]) == ("v3.0", 50, {"train": "0:2"})
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (2, 50, 1)
    assert {name: info["features"][name] for name in DEFAULT_FEATURES} == DEFAULT_FEATURES
    table = pq.read_table(out / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(table.column_names) == set(info["features"])
    for name, feature in info["features"].items():
        scalar = pa.bool_() if feature["dtype"] == "bool" else getattr(pa, feature["dtype"])()
        size = feature["shape"][0]
        assert table.schema.field(name).type == (scalar if size == 1 else pa.list_(scalar, size))
        assert feature["names"] is None or len(feature["names"]) == size
        assert "/" not in name


def test_frames_are_those_of_the_executions(dataset):
    out, episodes = dataset
    rows = pq.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
    assert rows["index"] == list(range(50))
    assert rows["episode_index"] == [0] * 30 + [1] * 20
    assert rows["frame_index"] == [*range(30), *range(20)]
    assert np.allclose(rows["timestamp"], np.array(rows["frame_index"]) / 50, rtol=0, atol=1e-4)
    state, action = np.array(rows["observation.state"]), np.array(rows["action"])
    for start, episode in zip((0, 30), episodes, strict=True):
        own = slice(start, start + len(episode["time"]))
        assert np.allclose(state[own, :3], episode["T_world_palm"][:, :3, 3], atol=1e-6)
        assert np.allclose(state[own, 7:], episode["joint_angles"], atol=1e-6)
        assert np.allclose(action[own, :7], episode["mocap"], atol=1e-6)
        assert np.allclose(action[own, 7:], episode["commanded_joint_angles"], atol=1e-6)
        for quaternion, pose in zip(state[own, 3:7], episode["T_world_palm"], strict=True):
            assert np.allclose(trimesh.transformations.quaternion_matrix(quaternion)[:3, :3], pose[:3, :3], atol=1e-5)
        assert (np.linalg.norm(np.diff(state[own, 3:7], axis=0), axis=1) < 1.0).all()  # no jump to the other sign
    assert np.flatnonzero(rows["next.done"]).tolist() == [29, 49]
    assert np.flatnonzero(rows["next.success"]).tolist() == [29]


def test_the_record_of_an_end_between_two_frames_is_left_out(tmp_path):
    """As `execute` writes where a push ends 4 ms after a frame."""
    times = np.append(0.02 * np.arange(RECORDS - 1), 0.02 * (RECORDS - 2) + 0.004)
    write_episode(tmp_path / "run", time=times)
    (tmp_path / "out").mkdir()
    assert write_lerobot(tmp_path / "run", tmp_path / "out", task="push", robot="hand", version="1") == 1
    data = pq.read_table(tmp_path / "out" / "data/chunk-000/file-000.parquet")
    np.testing.assert_allclose(data["timestamp"].to_numpy(), times[:-1], atol=1e-6)
    assert data["next.done"].to_pylist() == [False] * (RECORDS - 2) + [True]


def test_an_execution_of_several_holds_is_read_by_the_nearest_records(tmp_path):
    """Each hold ends between two frames, and the next counts from there."""
    times = np.concatenate([0.02 * np.arange(10), 0.184 + 0.02 * np.arange(10), 0.38 + 0.02 * np.arange(RECORDS - 20)])
    written = write_episode(tmp_path / "run", time=times)
    (tmp_path / "out").mkdir()
    assert write_lerobot(tmp_path / "run", tmp_path / "out", task="push", robot="hand", version="1") == 1
    data = pq.read_table(tmp_path / "out" / "data/chunk-000/file-000.parquet")
    frames = data["timestamp"].to_numpy()
    np.testing.assert_allclose(np.diff(frames), 0.02, atol=1e-6)
    assert frames[-1] == pytest.approx(times[-1], abs=0.02)
    nearest = [int(np.abs(times - time).argmin()) for time in frames]
    state = np.array(data["observation.state"].to_pylist())
    np.testing.assert_allclose(state[:, :3], written["T_world_palm"][nearest, :3, 3], atol=1e-6)


def test_episodes_tasks_and_statistics(dataset):
    out, _ = dataset
    episodes = pq.read_table(out / "meta/episodes/chunk-000/file-000.parquet")
    assert {name for name in episodes.column_names if not name.startswith("stats/")} == EPISODE_COLUMNS
    rows = episodes.to_pydict()
    assert rows["tasks"] == [["push it"]] * 2
    assert (rows["dataset_from_index"], rows["dataset_to_index"], rows["length"]) == ([0, 30], [30, 50], [30, 20])
    tasks = pq.read_table(out / "meta/tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0], "task": ["push it"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]  # what pandas makes the index
    states = np.array(pq.read_table(out / "data/chunk-000/file-000.parquet")["observation.state"].to_pylist())
    stats = json.loads((out / "meta/stats.json").read_text())["observation.state"]
    assert np.allclose(stats["mean"], states.mean(axis=0), atol=1e-6)
    assert np.allclose(stats["std"], states.std(axis=0), atol=1e-6)
    assert stats["count"] == [50]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time": 0.05 * np.arange(RECORDS)}, "over 20 ms apart"),
        ({"time": np.append(0.02 * np.arange(RECORDS - 1), 1e12)}, "over 20 ms apart"),
        ({"joint_angles": np.full((RECORDS, 2), np.nan)}, "NaN"),
        ({"T_world_object": np.tile(np.eye(4), (3, 1, 1))}, r"shape \(3, 4, 4\)"),
        ({"joint_names": np.array(["FFJ4", "THJ1"])}, "another hand"),
        ({"mocap": np.zeros((RECORDS, 9))}, r"mocap is .*\(30, 9\)"),
        ({"mocap": np.zeros(RECORDS)}, r"mocap is .*\(30,\)"),
    ],
)
def test_what_is_no_series_of_one_hand_is_refused(changes, message, tmp_path):
    write_episode(tmp_path / "run/a")
    write_episode(tmp_path / "run/b", **changes)
    with pytest.raises(InputError, match=message):
        write_lerobot(tmp_path / "run", tmp_path / "out", task="t", robot="r", version="0")


def test_damaged_and_missing_episodes_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"holds no episode\.npz"):
        write_lerobot(tmp_path, tmp_path / "out", task="t", robot="r", version="0")
    write_episode(tmp_path / "run/a")
    path = tmp_path / "run/a/episode.npz"
    path.write_bytes(path.read_bytes()[:-60])
    with pytest.raises(InputError, match="damaged"):
        write_lerobot(tmp_path / "run", tmp_path / "out", task="t", robot="r", version="0")


@pytest.mark.parametrize("told", [{"success": "no"}, {"success": 1}, {"success": None}, {}])
def test_an_episode_that_does_not_say_whether_it_succeeded_is_refused(tmp_path, told):
    write_episode(tmp_path / "run/a")
    (tmp_path / "run/a/episode.json").write_text(json.dumps(told))
    with pytest.raises(InputError, match=r"episode\.json: success is .*; expected true or false; execute again"):
        write_lerobot(tmp_path / "run", tmp_path / "out", task="t", robot="r", version="0")
