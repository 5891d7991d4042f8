"""The manifest survives a round trip and says what is wrong with a bad one."""

import json

import pytest

from dexnudge.dataset.manifest import DamagedManifestError, read_manifest, write_manifest
from dexnudge.errors import DatasetError


def test_round_trip(toy, tmp_path):
    manifest = toy.toy_manifest()
    manifest.failed_objects = {"object-2": "not watertight"}
    manifest.counts = {"push": {"attempted": 3}}
    write_manifest(tmp_path, manifest)
    assert read_manifest(tmp_path) == manifest


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format_version": 99}, r"has format version 99, expected 2; generate the dataset again"),
        ({"units": {"length": "mm", "angle": "rad"}}, r"has units .*'mm'.*, expected .*'m'"),
        (
            {"surprise": 1},
            r"has the unknown field 'surprise'; expected hand, joint_names, .*; the shards beside it are not lost",
        ),
        ({"objects": ["phone"]}, r"objects is \['phone'\]; expected an object"),
        ({"objects": {"../phone": None}}, r"object name '../phone' cannot be part of a file name"),
        ({"seed": True}, r"seed is True; expected a whole number"),
        ({"digit_joints": {"FF": [0, 99]}}, r"name a joint twice, or one that there is not"),
    ],
)
def test_foreign_content(toy, tmp_path, change, message):
    path = write_manifest(tmp_path, toy.toy_manifest())
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(DatasetError, match=message):
        read_manifest(tmp_path)


def test_the_file_keeps_its_older_name_for_joint_groups(toy, tmp_path):
    content = json.loads(write_manifest(tmp_path, toy.toy_manifest()).read_text())
    assert content["digit_joints"] == {name: list(joints) for name, joints in toy.DIGIT_JOINTS.items()}


def test_missing_broken_or_not_a_mapping(toy, tmp_path):
    with pytest.raises(DatasetError, match=r"manifest.json: no such file; .*`dexnudge dataset generate`"):
        read_manifest(tmp_path)
    path = write_manifest(tmp_path, toy.toy_manifest())
    path.write_text(path.read_text()[:50])
    with pytest.raises(DatasetError, match="cannot be read as JSON"):
        read_manifest(tmp_path)
    path.write_text("[]")
    with pytest.raises(DatasetError, match="holds a JSON list; expected an object"):
        read_manifest(tmp_path)


def test_a_folder_in_its_place_is_named_and_not_taken_for_damage(tmp_path):
    (tmp_path / "manifest.json").mkdir()
    with pytest.raises(
        DatasetError, match=r"manifest\.json is a folder; expected a file; move the folder away"
    ) as told:
        read_manifest(tmp_path)
    assert not isinstance(told.value, DamagedManifestError)


@pytest.mark.parametrize("name", ["../escape", "a/b", "", ".hidden", "with space"])
def test_object_names_cannot_leave_the_folder(toy, tmp_path, name):
    manifest = toy.toy_manifest()
    manifest.objects[name] = "0"
    with pytest.raises(DatasetError, match="cannot be part of a file name"):
        write_manifest(tmp_path, manifest)


def test_the_order_of_completion_leaves_no_trace(toy, tmp_path):
    orders = [["b", "a", "c"], ["c", "b", "a"]]
    written = []
    for order in orders:
        manifest = toy.toy_manifest()
        manifest.objects = {name: name * 8 for name in order}
        manifest.failed_objects = {f"{name}-failed": "broken" for name in order}
        written.append(write_manifest(tmp_path, manifest).read_bytes())
    assert written[0] == written[1]
