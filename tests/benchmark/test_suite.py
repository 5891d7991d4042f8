"""Suites and their tasks: the same for everyone, and what was changed is seen."""

import hashlib
import json
import shutil

import pytest
import yaml

from dexnudge.benchmark.suite import load_suite, suite_from
from dexnudge.benchmark.tasks import load_tasks, make_tasks
from dexnudge.errors import InputError, UnknownNameError
from dexnudge.objects.builtin import builtin_names, builtin_object
from dexnudge.scenes.scene import Scene
from dexnudge.synthesis.object_data import mesh_hash


def test_the_built_in_suites_are_of_test_objects():
    small, standard = load_suite("small"), load_suite("standard")
    assert len(small.tasks) == 18
    assert set(standard.objects) == set(builtin_names("test"))
    assert set(small.objects) <= set(standard.objects)
    with pytest.raises(UnknownNameError, match=r"did you mean 'small'.*expected one of small, standard"):
        load_suite("smal")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"draws": 0}, "draws is 0; expected 1 to 128"),
        ({"families": ["tabel"]}, "unknown family 'tabel' .did you mean 'table'"),
        ({"families": []}, "families is"),
        ({"seeds": [1, 1]}, "without doubles"),
        ({"seeds": [-1]}, r"seeds\[0\] is -1; expected 0 to"),
        ({"objects": ["../phone"]}, "objects is .*; expected names of letters"),
        ({"objects": {"phone-200": "abc"}}, "64 hexadecimal digits"),
        ({"hand": 3}, "hand is 3"),
        ({"extra": 1}, "has the unknown field 'extra'; expected name, version"),
    ],
)
def test_what_is_no_suite_is_refused(change, message, content):
    with pytest.raises((InputError, UnknownNameError), match=message):
        suite_from({**content, **change}, "tiny.yaml")


def test_tasks_are_the_same_again_and_whole_in_themselves(tasks, content, tmp_path):
    again = make_tasks(suite_from(content, "tiny"), tmp_path / "again")
    assert again.fingerprint == tasks.fingerprint
    assert [task.name for task in tasks.tasks][:3] == ["phone-200_table_0", "phone-200_table_1", "phone-200_layers_0"]
    one, two = (Scene.load(tasks.folder / "tasks" / name) for name in ("phone-200_table_0", "phone-200_table_1"))
    assert (one.name, two.name) == ("table", "table")
    assert not (one.T_world_object == two.T_world_object).all()  # another seed, another scene
    assert tasks.hand.joint_names[0] == "FFJ4"


def test_a_task_that_was_changed_is_seen(tasks, tmp_path):
    shutil.copytree(tasks.folder, tmp_path / "changed")
    path = tmp_path / "changed/tasks/phone-200_shelf_0/scene.json"
    path.write_text(path.read_text().replace('"friction_hand": 0.8', '"friction_hand": 1.8'))
    with pytest.raises(InputError, match=r"phone-200_shelf_0/scene\.json is not the file"):
        load_tasks(tmp_path / "changed")
    path.unlink()
    with pytest.raises(InputError, match="is not the file"):
        load_tasks(tmp_path / "changed")
    with pytest.raises(InputError, match="benchmark make"):
        load_tasks(tmp_path)


def test_objects_of_ones_own_are_found_by_name_and_known_by_their_hash(content, tmp_path):
    mesh = builtin_object("phone-003")
    (tmp_path / "meshes").mkdir()
    mesh.export(tmp_path / "meshes/mine.obj")
    content |= {"families": ["table"], "seeds": [0], "objects": ["mine"]}
    with pytest.raises(InputError, match=r"needs 1 objects that are not built in, such as mine"):
        make_tasks(suite_from(content, "own"), tmp_path / "out")
    made = make_tasks(suite_from(content, "own"), tmp_path / "out", objects=str(tmp_path / "meshes"))
    digest = mesh_hash(made.scene(made.tasks[0]).object_mesh)
    pinned = {**content, "objects": {"mine": mesh_hash(mesh)}}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(pinned))
    assert len(digest) == 64
    other = load_suite(str(tmp_path / "own.yaml"))
    with pytest.raises(InputError, match="is not the one that suite 'tiny' names"):
        make_tasks(other, tmp_path / "pinned", objects=str(tmp_path / "meshes"), length=0.2)
    assert not (tmp_path / "pinned").exists()


@pytest.mark.parametrize("changed", ["hand", "draws", "not_made"])
def test_the_fingerprint_covers_the_hand_and_what_is_asked(changed, tasks, tmp_path):
    folder = shutil.copytree(tasks.folder, tmp_path / "changed")
    path, urdf = folder / "manifest.json", folder / "hand/hand.urdf"
    content = json.loads(path.read_text())
    if changed == "hand":
        urdf.write_text(urdf.read_text().replace('upper="1.57', 'upper="2.57'))
        content["files"]["hand/hand.urdf"] = hashlib.sha256(urdf.read_bytes()).hexdigest()
        assert content != json.loads(path.read_text())
    elif changed == "draws":
        content["suite"]["draws"] = 3
    else:
        content["not_made"] = {tasks.tasks[0].name: "too hard"}
    path.write_text(json.dumps(content))
    assert load_tasks(folder).fingerprint != tasks.fingerprint


def test_the_manifest_names_every_file(tasks):
    files = json.loads((tasks.folder / "manifest.json").read_text())["files"]
    there = {str(path.relative_to(tasks.folder)) for path in tasks.folder.rglob("*") if path.is_file()}
    assert set(files) == there - {"manifest.json"}
