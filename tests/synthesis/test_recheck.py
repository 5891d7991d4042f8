"""`dataset check` verifies what is stored and names every number that lies."""

import re
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import trimesh

from dexnudge.cli.arguments import MOST_LISTED
from dexnudge.cli.main import main
from dexnudge.dataset.loading import load_dataset
from dexnudge.dataset.manifest import read_manifest, write_manifest
from dexnudge.dataset.shards import read_shard, shard_path
from dexnudge.errors import DatasetError
from dexnudge.synthesis.recheck import DRIFT_SHARE, DatasetCheck, _numbers, check_dataset

pytestmark = pytest.mark.slow  # a dataset is generated first
LETS_GO = 0.05  # [m] DexGraspBench's limit


def tamper(folder: Path, name: str, column: str, change: Callable[[dict], object]) -> int:
    """Rewrite a column, `change` giving each row's new value; how many rows differ now."""
    path = shard_path(folder, name)
    table = pq.read_table(path)
    rows, field = table.to_pylist(), table.schema.field(column)
    values = [change(row) for row in rows]
    place = table.schema.get_field_index(column)
    pq.write_table(table.set_column(place, field, pa.array(values, type=field.type)), path, write_page_checksum=True)
    return sum(row[column] != value for row, value in zip(rows, values, strict=True))


def first_of(rows: list[dict], *, grasp: bool) -> int:
    return next(index for index, row in enumerate(rows) if (row["behaviour"] == "grasp") == grasp)


def test_every_row_is_verified_again(data, objects):
    report = check_dataset(data, objects=str(objects), workers=2)
    assert report.differences == ()
    assert report.objects == 2
    assert report.verified == report.rows == len(load_dataset(data))


def test_a_sample_and_the_files_alone(data, objects):
    assert check_dataset(data, objects=str(objects), num=3, seed=0, workers=1).verified == 3
    assert check_dataset(data, objects=None, num=6, seed=0).verified == 0


# What is changed in the first row that is a grasp or not, and what is said about it.
LIES = {
    "margin": (False, "direction_margin", lambda old: [old[0] + 0.01, *old[1:]], r"direction_margin\[0\] is "),
    "contact point": (True, "contact_points", lambda old: [[old[0][0], old[0][1] - 0.0005, old[0][2]], *old[1:]],
                      r"contact_points\[0\]\[1\] is "),
    "link": (False, "contact_links", lambda old: ["palm", *old[1:]], r"contact_links are \('palm'"),
    "depth": (True, "penetration_self", lambda old: old + 0.0005, "penetration_self is "),
    "drift": (True, "hold_translation", lambda old: old + 1.1 * DRIFT_SHARE * LETS_GO, "hold_translation is "),
    "turn": (True, "hold_rotation", lambda old: old + 0.02, "hold_rotation is "),
    "no drift": (True, "hold_translation", lambda _: None, "hold_translation is nan in the file"),
    "drift of a push": (False, "hold_rotation", lambda _: 0.1, "hold_rotation is 0.10000 in the file, nan found"),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_one_number_that_lies_is_named_alone(copy, objects, names, lie):
    grasp, column, change, said = LIES[lie]
    rows = pq.read_table(shard_path(copy, names[0])).to_pylist()
    place = first_of(rows, grasp=grasp)
    assert tamper(copy, names[0], column, lambda row: change(row[column]) if row == rows[place] else row[column]) == 1
    (difference,) = check_dataset(copy, objects=str(objects), workers=1).differences
    assert re.match(rf"{names[0]}, row {place}: {said}", difference)


def test_a_contact_point_that_is_left_out_is_named(copy, objects, names):
    rows = pq.read_table(shard_path(copy, names[0])).to_pylist()
    place = first_of(rows, grasp=False)

    def left_out(row: dict) -> object:
        return row["contact_points"][1:] if row == rows[place] else row["contact_points"]

    assert tamper(copy, names[0], "contact_points", left_out) == 1
    (difference,) = check_dataset(copy, objects=str(objects), workers=1).differences
    assert f"row {place} is a row with other numbers of contact_links and contact_points" in difference


def test_what_another_machine_may_find_is_no_lie(copy, objects, names):
    tamper(copy, names[0], "hold_translation", lambda row: row["hold_translation"] and row["hold_translation"] + 0.001)
    tamper(copy, names[0], "direction_margin", lambda row: [value - 0.001 for value in row["direction_margin"]])
    tamper(copy, names[0], "penetration_self", lambda row: row["penetration_self"] + 5e-5)
    assert check_dataset(copy, objects=str(objects), workers=1).differences == ()


def test_a_moved_hand_is_told_as_the_reason_why_it_would_be_rejected(copy, objects, names):
    count = tamper(copy, names[0], "q", lambda row: [*row["q"][:2], row["q"][2] + 0.05, *row["q"][3:]])
    report = check_dataset(copy, objects=str(objects), workers=1)
    lies = [text for text in report.differences if "kept in the file, found to be rejected for" in text]
    assert len(lies) >= 0.9 * count > 0
    assert all(text.startswith(names[0]) for text in report.differences)


def test_counts_and_meshes_that_contradict_the_shards(copy, names):
    manifest = read_manifest(copy)
    manifest.counts["press"]["kept"] += 1
    manifest.objects[names[1]] = "0" * 64
    write_manifest(copy, manifest)
    found = check_dataset(copy, objects=None).differences
    assert any(re.match(r"manifest: .* attempts of press", text) for text in found)
    assert any(re.match(rf"{names[1]}: its shard is of the mesh .*, manifest: 0000", text) for text in found)
    assert len(found) == 2
    assert read_shard(copy, manifest, names[1]).mesh_hash != manifest.objects[names[1]]


def test_the_command_lists_twenty_lies_and_says_how_many_more(copy, objects, names, capsys):
    lies = sum(
        tamper(copy, name, "contact_points", lambda row: (np.asarray(row["contact_points"]) + 0.001).tolist())
        + tamper(copy, name, "penetration_object", lambda row: row["penetration_object"] + 0.001)
        for name in names
    )
    assert lies > MOST_LISTED
    command = ["dataset", "check", str(copy), "--objects", str(objects), "--workers", "1"]
    assert main(command) == 2
    message = capsys.readouterr().err
    listed = [line for line in message.splitlines() if re.match(rf"  ({'|'.join(names)}), row \d+: ", line)]
    assert len(listed) == MOST_LISTED == 20
    assert f"does not hold what it says, {lies} differences:" in message
    assert f"  and {lies - 20} more\n" in message
    assert len(message.strip().splitlines()) <= 20 + 3
    assert "Traceback" not in message


def test_without_objects_the_command_says_that_nothing_was_verified_again(data, copy, names, capsys, monkeypatch):
    rows = sum(len(read_shard(data, read_manifest(data), name).table) for name in names)
    assert main(["dataset", "check", str(data)]) == 0
    said = capsys.readouterr().out
    assert said == f"{rows} configurations of 2 objects read; none verified again: --objects SET verifies them\n"
    assert main(["dataset", "check", str(data), "--num", "1"]) == 2
    assert "--num is given without --objects" in capsys.readouterr().err

    monkeypatch.setattr("dexnudge.synthesis.dataset_card.builtin_set", lambda _: "builtin:train:2")
    assert main(["dataset", "check", str(copy)]) == 0
    assert capsys.readouterr().out.endswith("; none verified again: --objects builtin:train:2 verifies them\n")
    taken = Mock(return_value=DatasetCheck(2, rows, 1, ()))
    monkeypatch.setattr("dexnudge.synthesis.recheck.check_dataset", taken)
    assert main(["dataset", "check", str(copy), "--num", "1"]) == 0
    assert taken.call_args.kwargs["objects"] == "builtin:train:2"
    assert capsys.readouterr().out.endswith(", 1 verified again: all agree\n")


def test_another_set_is_refused(data, names, tmp_path):
    with pytest.raises(DatasetError, match=r"the mesh of 'bar' is not in .*; expected the set that the dataset was"):
        trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "box.obj")
        check_dataset(data, objects=str(tmp_path), workers=1)
    for name in names:
        trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / f"{name}.obj")
    with pytest.raises(DatasetError, match=r"the mesh of 'bar' in .* is not the one"):
        check_dataset(data, objects=str(tmp_path), workers=1)


@pytest.mark.parametrize(
    ("stored", "found", "said"),
    [
        ([1.0, 2.0], [1.05, 2.09], []),
        ([1.0, 2.0], [1.2, 2.3], ["x[1] is 2.00000 in the file, 2.30000 found"]),
        ([[1.0, np.nan]], [[1.0, 2.0]], ["x[0][1] is nan in the file, 2.00000 found"]),
        (None, np.nan, []),
        (None, 0.5, ["x is nan in the file, 0.50000 found"]),
        (0.5, np.nan, ["x is 0.50000 in the file, nan found"]),
    ],
)
def test_numbers_are_compared_with_what_is_missing(stored, found, said):
    assert _numbers("x", stored, found if isinstance(found, float) else np.asarray(found), 0.1) == said
