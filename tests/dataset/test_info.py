"""The totals are sums over shards, counted here from the rows."""

import numpy as np

from dexnudge.dataset.info import describe
from dexnudge.dataset.loading import load_dataset
from dexnudge.dataset.schema import BehaviourCounts
from dexnudge.dataset.shards import read_shard, shard_path


def test_totals(toy_folder):
    info = describe(toy_folder)
    dataset = load_dataset(toy_folder)
    assert info.num_objects == 3
    assert info.num_configurations == len(dataset)
    assert info.counts["grasp"] == BehaviourCounts(attempted=33, kept=18, failed=6, rejected={"penetration": 9})
    assert info.counts["push"] == BehaviourCounts(attempted=21, kept=18, rejected={"force": 3})
    feasible = dataset.direction_margin >= 1.0
    assert info.feasible_rows == feasible.sum(axis=0).tolist()
    covered = np.stack([feasible[dataset.object_index == k].any(axis=0) for k in range(3)])
    assert info.objects_covered == covered.sum(axis=0).tolist()
    shards = [read_shard(toy_folder, dataset.manifest, name) for name in dataset.object_names]
    digits = [row for shard in shards for row in shard.table.column("digits").to_pylist()]
    assert info.digit_use == {digit: sum(digit in row for row in digits) for digit in ("FF", "TH")}
    per_row = info.digits_per_configuration["grasp"].items() | info.digits_per_configuration["push"].items()
    assert {number for number, _ in per_row} == {len(row) for row in digits}
    assert sum(sum(row.values()) for row in info.digits_per_configuration.values()) == len(digits)


def test_table_and_unfinished_objects(toy_folder):
    shard_path(toy_folder, "object-1").unlink()
    lines = describe(toy_folder).table().splitlines()
    assert lines[0] == "hand toy: 24 configurations of 2 objects (1 not generated yet, 0 failed)"
    assert lines[2].split() == ["behaviour", "attempted", "kept", "kept", "%", "failed", "force", "penetration"]
    assert lines[3].split() == ["grasp", "22", "12", "54.5", "4", "0", "6"]
    assert lines[5].split() == ["press", "0", "0", "-", "0", "0", "0"]
    assert any(line.startswith("direction [deg]  0  22.5") for line in lines)
