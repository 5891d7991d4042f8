"""The data card's numbers are those of the rows, its columns those of the files, and its examples run."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from dexnudge.dataset.loading import load_dataset
from dexnudge.dataset.manifest import Manifest, read_manifest, write_manifest
from dexnudge.objects.builtin import builtin_names, builtin_object
from dexnudge.simulation import hold
from dexnudge.synthesis import acceptance
from dexnudge.synthesis.dataset_card import builtin_set, write_card
from dexnudge.synthesis.object_data import mesh_hash

ROOT = Path(__file__).parents[2]


@pytest.fixture
def text(toy_folder) -> str:
    return write_card(toy_folder).read_text(encoding="utf-8")


def cells(text: str, label: str) -> list[str]:
    line = next(line for line in text.splitlines() if line.startswith(f"| {label} |"))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_counts_are_those_of_the_rows(toy_folder, text):
    rows = pa.concat_tables(pq.read_table(file) for file in toy_folder.glob("shard-*.parquet")).to_pylist()
    pushes = [row for row in rows if row["behaviour"] == "push"]
    assert f"- {len(rows)} configurations: {len(rows) - len(pushes)} grasp, {len(pushes)} push, 0 press, 0 hook" in text
    assert "hand: toy, 16 joint angles, digits FF, MF, RF, TH" in text
    assert cells(text, "grasp")[:5] == ["grasp", "33", "18", "54.5", "6"]
    files = [file for file in toy_folder.iterdir() if file.name != "README.md"]
    shards = sum(file.stat().st_size for file in files if file.name.startswith("shard-"))
    size = sum(file.stat().st_size for file in files)
    assert f"- {size} bytes in all: shards, {shards / len(rows):.0f} per configuration; surface points" in text
    assert "- behaviours without a row: press, hook\n" in text
    assert "- digits that no row uses: MF, RF\n" in text


def test_columns_are_those_of_the_files_with_unit_and_meaning(toy_folder, text):
    schema = pq.read_schema(next(toy_folder.glob("shard-*.parquet")))
    for field in schema:
        line = cells(text, f"`{field.name}`")
        assert line[2] == field.metadata[b"unit"].decode()
        assert line[4] == field.metadata[b"description"].decode()
    assert cells(text, "`q`")[1] == "float[25]"
    assert cells(text, "`contact_points`")[1] == "list of float[3]"


def test_criteria_are_those_of_the_code(toy_folder, text, monkeypatch):
    assert f"at most {1e3 * acceptance.PENETRATION_LIMIT:g} mm each" in text
    monkeypatch.setattr("dexnudge.synthesis.dataset_card.PENETRATION_LIMIT", 0.0025)
    assert "at most 2.5 mm each" in write_card(toy_folder).read_text(encoding="utf-8")


def test_held_grasps_are_counted_with_the_limits_of_the_test(toy_folder, text):
    assert f"18 of 18 grasps were held in MuJoCo against a pull of {hold.PULL:g} N in 6 directions" in text
    assert f"less than {1e3 * hold.FARTHEST:g} mm and 15 degrees" in text
    for shard in toy_folder.glob("shard-*"):
        shard.unlink()
    assert "No row was held in simulation" in write_card(toy_folder).read_text(encoding="utf-8")


def test_both_ways_of_loading_run(toy_folder, text):
    examples = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert len(examples) == 2
    dataset = load_dataset(toy_folder)
    printed = [
        subprocess.run(
            [sys.executable, "-c", f"FOLDER = {str(toy_folder)!r}\n{example}\nprint({last})"],
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for example, last in zip(examples, ("''", "q.shape, float(abs(q).sum())"), strict=True)
    ]
    assert str(dataset.q.shape) in printed[0]
    assert printed[1].strip() == f"{dataset.q.shape} {float(np.abs(dataset.q).sum())}"


def test_command_and_versions(toy_folder):
    manifest = read_manifest(toy_folder)
    manifest.config = {"hand": "toy", "length": None, "non_prehensile": 24}
    manifest.versions = {"torch": "2.0", "dexnudge": "0.1"}
    for shard in toy_folder.glob("shard-*"):
        shard.unlink()
    write_manifest(toy_folder, manifest)
    text = write_card(toy_folder).read_text(encoding="utf-8")
    assert "\ndexnudge dataset generate --objects SET --hand toy --non-prehensile 24 --seed 7 --out FOLDER\n" in text
    assert "Versions: dexnudge 0.1, torch 2.0." in text


def test_builtin_sets_are_known_by_their_names(toy):
    manifest: Manifest = toy.toy_manifest()
    assert builtin_set(manifest) is None
    manifest.objects = dict.fromkeys(builtin_names("test"), None)
    failed = next(iter(manifest.objects))
    del manifest.objects[failed]
    assert builtin_set(manifest) is None
    manifest.failed_objects = {failed: "reason"}
    assert builtin_set(manifest) == "builtin:test"
    manifest.objects, manifest.failed_objects = dict.fromkeys(builtin_names("test")[::14], None), {}
    assert builtin_set(manifest) == "builtin:test:3"


def test_files_with_the_names_of_builtin_objects_are_no_builtin_set(toy):
    manifest: Manifest = toy.toy_manifest()
    name = builtin_names("train")[0]
    manifest.objects = {name: mesh_hash(builtin_object(name))}
    assert builtin_set(manifest) == "builtin:train:1"
    manifest.objects = {name: "0" * 64}
    assert builtin_set(manifest) is None


def test_a_hub_finds_licence_size_and_files(toy_folder, text):
    block = yaml.safe_load(text.split("---\n")[1])
    assert "license" not in block  # the toy's objects are somebody's
    assert (block["task_categories"], block["size_categories"]) == (["robotics"], ["n<1K"])
    configs = {config["config_name"]: config["data_files"] for config in block["configs"]}
    for name, pattern in (("configurations", "shard-*"), ("objects", "object-*")):
        (files,) = configs[name]
        assert sorted(toy_folder.glob(files["path"])) == sorted(toy_folder.glob(f"{pattern}.parquet"))
    released = (ROOT / "datasets/shadow_lite/README.md").read_text(encoding="utf-8")
    block = yaml.safe_load(released.split("---\n")[1])
    assert (block["license"], block["size_categories"]) == ("mit", ["100K<n<1M"])


def test_the_same_data_give_the_same_bytes_with_the_card_in_place(toy_folder, text):
    assert write_card(toy_folder).read_text(encoding="utf-8") == text
