"""A whole run on tiny budgets: what fails is named and the rest goes on, and a run can be told from another."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from dexnudge.dataset.loading import load_dataset
from dexnudge.dataset.manifest import read_manifest, write_manifest
from dexnudge.dataset.shards import cloud_path, read_shard, shard_path
from dexnudge.errors import DatasetError, HandError, InputError, MeshError, OutputError
from dexnudge.geometry.meshes import load_mesh
from dexnudge.jobs.progress import progress
from dexnudge.objects.builtin import builtin_object
from dexnudge.synthesis.generate import GenerationLog, generate_dataset
from dexnudge.synthesis.object_data import GenerationConfig, ObjectOutcome, mesh_hash, object_seed


def test_the_log_says_what_was_repaired(tmp_path, capsys):
    with progress() as bars:
        log = GenerationLog(tmp_path, bars, total=2, finished=0)
        log.add("clean", ObjectOutcome())
        log.add("twosided", ObjectOutcome(repairs=("2 of 12 faces stood there twice and count once",)))
        log.end("finished")
    clean, twosided = log_lines(tmp_path, "object")
    assert "repairs" not in clean
    assert twosided["repairs"] == ["2 of 12 faces stood there twice and count once"]
    assert capsys.readouterr().err == "1 object was repaired when read; log.jsonl says how\n"


def log_lines(folder, event: str) -> list[dict]:
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [line for line in lines if line["event"] == event]


@pytest.mark.slow
def test_counts_add_up_and_the_broken_mesh_is_named(data, names, config):
    manifest = read_manifest(data)
    assert set(manifest.objects) == set(names)
    assert set(manifest.failed_objects) == {"broken"}
    assert "a point cloud must be meshed first" in manifest.failed_objects["broken"]
    attempted = {behaviour: counts["attempted"] for behaviour, counts in manifest.counts.items()}
    assert attempted.pop("grasp") == config.grasps * len(names)
    assert sum(attempted.values()) == config.non_prehensile * len(names)
    for counts in manifest.counts.values():
        assert counts["attempted"] == counts["kept"] + counts["failed"] + sum(counts["rejected"].values())
    dataset = load_dataset(data)
    assert len(dataset) == sum(counts["kept"] for counts in manifest.counts.values()) > 0


@pytest.mark.slow
def test_the_log_tells_of_every_object_and_the_rate(data, names):
    ended = {line["name"]: line for line in log_lines(data, "object")}
    assert set(ended) == {*names, "broken"}
    assert "a point cloud" in ended["broken"]["failed"]
    (end,) = log_lines(data, "end")
    assert end["kept"] == len(load_dataset(data)) == sum(line["kept"] for line in ended.values())
    assert end["kept_per_second"] == pytest.approx(end["kept"] / end["seconds"], rel=0.02)
    assert end["attempted"] == end["kept"] + sum(end["rejected"].values())


@pytest.mark.slow
def test_provenance(data, objects, names, config):
    manifest = read_manifest(data)
    for name, digest in manifest.objects.items():
        assert mesh_hash(load_mesh(objects / f"{name}.obj")) == digest
        header = json.loads(pq.read_schema(shard_path(data, name)).metadata[b"dexnudge"])
        assert header["mesh_sha256"] == digest
        assert header["config"] == vars(config) == manifest.config
        assert header["seed"] == manifest.seed == 4
        assert header["versions"] == manifest.versions
    assert {"dexnudge", "mujoco", "numpy", "torch", "warp-lang"} <= set(manifest.versions)


@pytest.mark.slow
def test_every_stored_point_of_contact_lies_on_the_object(data, names):
    for name in names:
        table = read_shard(data, read_manifest(data), name).table
        cloud = np.stack([pq.read_table(cloud_path(data, name)).column(axis) for axis in ("px", "py", "pz")], axis=1)
        for links, points in zip(table["contact_links"].to_pylist(), table["contact_points"].to_pylist(), strict=True):
            assert len(links) == len(points) > 0
            for point in points:
                assert (abs(cloud - point) ** 2).sum(axis=1).min() ** 0.5 < 0.02


@pytest.mark.slow
def test_the_number_of_workers_changes_no_byte(data, objects, config, tmp_path, files_of):
    generate_dataset(str(objects), tmp_path, config, seed=4, workers=2)
    assert files_of(tmp_path) == files_of(data)


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage", ["shard missing", "shard truncated", "shard header", "cloud truncated", "cloud header", "cloud missing"]
)
def test_what_is_missing_or_damaged_is_named_and_made_again(
    copy, data, objects, config, names, files_of, damage, capsys
):
    broken, kept = names
    path = (shard_path if damage.startswith("shard") else cloud_path)(copy, broken)
    if damage.endswith("missing"):
        path.unlink()
    elif damage.endswith("header"):  # a flipped bit in the key of the whole header
        table = pq.read_table(path)
        pq.write_table(table.replace_schema_metadata({b"dexnudgd": table.schema.metadata[b"dexnudge"]}), path)
    else:
        path.write_bytes(path.read_bytes()[:-400])
    before = shard_path(copy, kept).stat().st_mtime_ns
    generate_dataset(str(objects), copy, config, seed=4, workers=1)
    assert files_of(copy) == files_of(data)
    assert shard_path(copy, kept).stat().st_mtime_ns == before
    damaged = log_lines(copy, "start")[-1]["damaged"]
    message = capsys.readouterr().err
    if damage == "shard missing":  # what a stop leaves: nothing to be told
        assert damaged == {}
    else:
        assert list(damaged) == [broken]
        assert f"object {broken} is generated again: " in message
    said = "its header cannot be read" if damage.endswith("header") else "cannot be read as Parquet: truncated"
    assert said in message or damage.endswith("missing")


@pytest.mark.slow
@pytest.mark.parametrize("damage", [lambda path: path.unlink(), lambda path: path.write_text(path.read_text()[:300])])
def test_a_manifest_that_is_lost_is_made_anew_from_the_shards(copy, data, objects, config, names, files_of, damage):
    written = {name: shard_path(copy, name).stat().st_mtime_ns for name in names}
    damage(copy / "manifest.json")
    with pytest.raises(DatasetError, match=r"manifest\.json: .*`dexnudge dataset generate`"):
        read_manifest(copy)
    with pytest.raises(DatasetError, match="another seed: expected 5, got 4"):  # the folder can be read again even so
        generate_dataset(str(objects), copy, config, seed=5, workers=1)
    assert read_manifest(copy) == replace(read_manifest(data), failed_objects={})
    damage(copy / "manifest.json")
    generate_dataset(str(objects), copy, config, seed=4, workers=1)
    assert files_of(copy) == files_of(data)
    assert {name: shard_path(copy, name).stat().st_mtime_ns for name in names} == written


@pytest.mark.slow
@pytest.mark.parametrize(
    "twisted",
    [
        {"seed": 44},
        {"config": {}},
        {"objects": {}, "failed_objects": {"foo": "bad"}},
        {"digit_joints": {"FF": [0]}},
        {"sliding_joints": ["FFJ4"]},
    ],
)
def test_a_manifest_that_alone_has_changed_is_made_anew(copy, data, objects, config, names, files_of, twisted):
    written = {name: shard_path(copy, name).stat().st_mtime_ns for name in names}
    content = json.loads((copy / "manifest.json").read_text()) | twisted
    (copy / "manifest.json").write_text(json.dumps(content))
    generate_dataset(str(objects), copy, config, seed=4, workers=1)
    assert files_of(copy) == files_of(data)
    assert {name: shard_path(copy, name).stat().st_mtime_ns for name in names} == written


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "seed", "label"), [({"non_prehensile": 25}, 4, "`non_prehensile`"), ({}, 5, "seed")]
)
def test_another_run_is_refused_in_the_same_folder(copy, objects, config, files_of, changed, seed, label):
    before = files_of(copy)
    with pytest.raises(DatasetError, match=rf"holds a dataset with another {label}: expected \d+, got \d+; choose"):
        generate_dataset(str(objects), copy, replace(config, **changed), seed=seed, workers=1)
    assert files_of(copy) == before


@pytest.mark.slow
def test_other_versions_and_foreign_shards_are_refused(copy, objects, config, names):
    with pytest.raises(DatasetError, match=r"has object 'bar', expected 'slab'; it belongs to another"):
        shard_path(copy, names[1]).write_bytes(shard_path(copy, names[0]).read_bytes())
        generate_dataset(str(objects), copy, config, seed=4, workers=1)
    for name in names:  # which say the versions, too
        shard_path(copy, name).unlink()
    manifest = read_manifest(copy)
    manifest.versions["torch"] = "1.0"
    write_manifest(copy, manifest)
    with pytest.raises(DatasetError, match=r"another version of torch: expected '[^']*', got '1.0';"):
        generate_dataset(str(objects), copy, config, seed=4, workers=1)
    content = json.loads((copy / "manifest.json").read_text()) | {"format_version": 1}
    (copy / "manifest.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match=r"has format version 1, expected 2; generate the dataset again"):
        generate_dataset(str(objects), copy, config, seed=4, workers=1)


def test_nothing_to_do_is_said_before_any_work(tmp_path, config):
    empty, out = tmp_path / "empty", tmp_path / "out"
    empty.mkdir()
    with pytest.raises(MeshError, match="no meshes in this folder"):
        generate_dataset(str(empty), out, config)
    with pytest.raises(InputError, match=r"nothing to attempt: .*; expected one of them above 0"):
        generate_dataset("builtin:train", out, GenerationConfig(non_prehensile=0, grasps=0))
    assert not out.exists()


def test_a_hand_without_fingertips_is_refused(tmp_path, config):
    (tmp_path / "stick.urdf").write_text(
        '<robot name="stick"><link name="palm"><collision><geometry><box size="0.1 0.1 0.02"/></geometry></collision>'
        '</link><link name="rod"><collision><geometry><box size="0.02 0.02 0.1"/></geometry></collision></link>'
        '<joint name="j" type="revolute"><parent link="palm"/><child link="rod"/><axis xyz="1 0 0"/>'
        '<limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    (tmp_path / "stick.yaml").write_text("palm: palm\npalm_normal: [0, 0, 1]\nfingertips: {}\n")
    with pytest.raises(HandError, match="fingertip"):
        generate_dataset(
            "builtin:train", tmp_path / "out", GenerationConfig(hand=str(tmp_path / "stick.urdf"), grasps=1)
        )
    assert not (tmp_path / "out").exists()


def test_a_folder_of_something_else_is_refused_and_kept(tmp_path, config):
    kept = {"README.md": "my own notes", "manifest.json": '{"a": ', ".writing-mine.txt": "mine"}
    for name, text in kept.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(OutputError, match=r"holds 'README.md' and no dataset; expected a new folder"):
        generate_dataset("builtin:train", tmp_path, config)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == kept


def test_a_folder_that_cannot_be_made(tmp_path, config):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="cannot be made"):
        generate_dataset("builtin:train", tmp_path / "file" / "out", config)


@pytest.mark.slow
def test_a_set_of_broken_meshes_alone_is_an_error(tmp_path, config):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "broken.obj").write_text("v 0 0 0\n")
    with pytest.raises(DatasetError, match=r"none of the 1 objects of .* could be generated; the first, broken: "):
        generate_dataset(str(tmp_path / "set"), tmp_path / "out", config, workers=1)
    assert set(read_manifest(tmp_path / "out").failed_objects) == {"broken"}


def test_an_objects_seed_depends_on_its_name_and_the_runs_seed_alone():
    assert object_seed(1, "a") == object_seed(1, "a")
    assert object_seed(1, "a") != object_seed(2, "a")
    assert object_seed(1, "a") != object_seed(1, "b")


def test_the_hash_sees_every_vertex_and_face():
    mesh = builtin_object("phone")
    moved, turned = mesh.copy(), mesh.copy()
    moved.vertices[3] += 1e-12
    turned.faces[0] = turned.faces[0][[1, 2, 0]]
    assert len({mesh_hash(mesh), mesh_hash(moved), mesh_hash(turned)}) == 3
    assert mesh_hash(mesh) == mesh_hash(builtin_object("phone"))
