"""The totals are sums over shards, counted here from the rows with pyarrow and plain loops."""

import math
from collections import Counter

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dexnudge.dataset.info import describe, joint_limits
from dexnudge.dataset.manifest import read_manifest
from dexnudge.dataset.schema import BehaviourCounts
from dexnudge.dataset.shards import shard_path
from dexnudge.dataset.tables import joints_table, report, tables
from dexnudge.hands.shadow_lite import shadow_lite


def all_rows(folder) -> list[dict]:
    return pa.concat_tables(pq.read_table(file) for file in sorted(folder.glob("shard-*.parquet"))).to_pylist()


def test_counts(toy_folder):
    info = describe(toy_folder)
    assert (info.num_objects, info.missing_objects) == (3, 0)
    assert info.num_configurations == len(all_rows(toy_folder))
    assert info.counts["grasp"] == BehaviourCounts(attempted=33, kept=18, failed=6, rejected={"penetration": 9})
    assert info.counts["push"] == BehaviourCounts(attempted=21, kept=18, rejected={"force": 3})


def test_coverage(toy_folder):
    info, rows = describe(toy_folder), all_rows(toy_folder)
    for behaviour in ("grasp", "push"):
        mine = [row for row in rows if row["behaviour"] == behaviour]
        use = Counter(digit for row in mine for digit in row["digits"])
        assert info.digit_use[behaviour] == {digit: use[digit] for digit in ("FF", "MF", "RF", "TH")}
        numbers = Counter(len(row["digits"]) for row in mine)
        assert info.digits_per_configuration[behaviour] == {str(n): numbers[n] for n in range(5)}
        azimuths = [math.degrees(math.atan2(row["q"][1], row["q"][0])) for row in mine]
        assert info.octant_rows[behaviour]["+x"] == sum(-22.5 < azimuth < 22.5 for azimuth in azimuths)
        assert info.octant_rows[behaviour]["-y"] == sum(-112.5 < azimuth < -67.5 for azimuth in azimuths)
        assert sum(info.octant_rows[behaviour].values()) == len(mine)
    feasible = {
        (row["object"], k, n) for n, row in enumerate(rows) for k in range(16) if row["direction_margin"][k] >= 1
    }
    assert info.feasible_rows == [sum(k == of for _, of, _ in feasible) for k in range(16)]
    assert info.objects_covered == [len({name for name, of, _ in feasible if of == k}) for k in range(16)]


def test_spread_and_size(toy_folder):
    info, rows = describe(toy_folder), all_rows(toy_folder)
    by_name = {histogram.quantity: histogram for histogram in info.histograms}
    margins = sorted(max(row["direction_margin"]) for row in rows if row["behaviour"] == "push")
    margin = by_name["force margin in the best direction"]
    assert set(margin.counts) == {"push"}
    assert margin.counts["push"].sum() == len(margins)
    assert margin.quantiles["push"][[0, 4]] == pytest.approx([margins[0], margins[-1]])
    deepest = by_name["deepest penetration"]
    assert deepest.quantiles["grasp"] == pytest.approx([0.2] * 5)  # mm
    assert by_name["drift while held"].quantiles["grasp"] == pytest.approx([4.0] * 5)  # mm
    assert by_name["turn while held"].quantiles["grasp"] == pytest.approx([math.degrees(0.02)] * 5)
    assert set(by_name["drift while held"].counts) == {"grasp"}
    angles = np.array([row["q"][9:] for row in rows])
    np.testing.assert_allclose(info.joint_angles, np.stack([angles.min(0), np.median(angles, 0), angles.max(0)], 1))
    files = [*toy_folder.glob("*.parquet"), toy_folder / "manifest.json"]
    assert info.bytes_on_disk == sum(file.stat().st_size for file in files)
    shards = sum(file.stat().st_size for file in toy_folder.glob("shard-*"))
    assert info.bytes_per_row == pytest.approx(shards / len(rows))


def test_joints_in_percent_of_the_hand_that_the_manifest_names(toy_folder):
    manifest = read_manifest(toy_folder)
    assert joint_limits(manifest) is None  # nobody has a hand "toy"
    assert len(joints_table(describe(toy_folder)).header) == 4
    manifest.config = {"hand": "shadow_lite"}
    hand = shadow_lite()
    np.testing.assert_array_equal(joint_limits(manifest), np.stack([hand.lower, hand.upper], axis=1))


def test_report_and_unfinished_objects(toy_folder):
    shard_path(toy_folder, "object-1").unlink()
    lines = report(describe(toy_folder)).splitlines()
    assert lines[0].startswith(
        "hand toy: 24 configurations of 2 objects (1 not generated yet, 0 failed), 0.1 MB on disk, "
    )
    assert lines[2].split() == [
        *("behaviour", "attempted", "kept", "kept", "%", "failed", "rejected:", "force", "rejected:", "penetration")
    ]
    assert lines[3].split() == ["grasp", "22", "12", "54.5", "4", "0", "6"]
    assert lines[5].split() == ["press", "0", "0", "-", "0", "0", "0"]
    assert any(line.startswith("feasible direction [deg]  0  22.5") for line in lines)


def test_an_empty_dataset_is_described(toy_folder):
    for shard in toy_folder.glob("shard-*"):
        shard.unlink()
    info = describe(toy_folder)
    assert (info.num_configurations, info.missing_objects, info.bytes_per_row) == (0, 3, 0.0)
    assert info.histograms == ()
    assert all(table.text() for table in tables(info))
