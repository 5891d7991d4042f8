"""A suite of one object in three families with two seeds: six tasks of two draws."""

import json

import numpy as np
import pytest

from dexnudge.benchmark.suite import suite_from
from dexnudge.benchmark.tasks import make_tasks
from dexnudge.formats.hand_poses import palm_poses

CONTENT = {
    "name": "tiny",
    "version": 1,
    "hand": "shadow_lite",
    "base": False,
    "draws": 2,
    "families": ["table", "layers", "shelf"],
    "seeds": [0, 1],
    "objects": ["phone-200"],
}


@pytest.fixture
def content():
    return json.loads(json.dumps(CONTENT))


@pytest.fixture(scope="session")
def tasks(tmp_path_factory):
    return make_tasks(suite_from(CONTENT, "tiny"), tmp_path_factory.mktemp("suite") / "tiny")


@pytest.fixture(scope="session")
def inside(tasks):
    """Two hands whose palms are in what carries the object: poses, verified by nobody, and never played."""
    q = np.zeros((2, 9 + tasks.hand.num_joints))
    q[:, 3] = q[:, 7] = 1.0
    q[1, 0] = 0.01  # no repeat of the first
    return {
        "joint_names": list(tasks.hand.joint_names),
        "T_world_palm": palm_poses(q).tolist(),
        "joint_angles": q[:, 9:].tolist(),
    }


@pytest.fixture
def entry_folder(tasks, inside, tmp_path):
    """An entry with an answer to every task."""
    folder = tmp_path / "entry"
    (folder / "answers").mkdir(parents=True)
    said = {"name": "mine", "authors": "A. Author", "used": "nothing", "machine": "a laptop"}
    said["seconds"] = {task.name: float(place) for place, task in enumerate(tasks.tasks)}
    (folder / "entry.json").write_text(json.dumps(said))
    for task in tasks.tasks:
        (folder / "answers" / f"{task.name}.json").write_text(json.dumps(inside))
    return folder
