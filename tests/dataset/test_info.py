"""The totals are sums over shards, counted here from the rows with pyarrow and plain loops."""

import math
from collections import Counter

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dexnudge.dataset.info import BINS, describe, histogram, known_hand, round_edges
from dexnudge.dataset.manifest import read_manifest, write_manifest
from dexnudge.dataset.schema import BehaviourCounts
from dexnudge.hands.named.shadow import shadow_lite


def all_rows(folder) -> list[dict]:
    return pa.concat_tables(pq.read_table(file) for file in sorted(folder.glob("shard-*.parquet"))).to_pylist()


def test_counts(toy_folder):
    info = describe(toy_folder)
    assert (info.num_objects, info.missing_objects, info.num_held) == (3, 0, 18)
    assert info.num_configurations == len(all_rows(toy_folder))
    assert info.counts["grasp"] == BehaviourCounts(attempted=33, kept=18, failed=6, rejected={"penetration": 9})
    assert info.counts["push"] == BehaviourCounts(attempted=21, kept=18, rejected={"force": 3})
    row = {"attempted": 33, "kept": 18, "kept %": 54.5, "failed": 6, "rejected: force": 0, "rejected: penetration": 9}
    assert info.tables["counts"].row("grasp") == row
    assert info.tables["counts"].row("press")["kept %"] == "-"


def test_coverage(toy_folder):
    tables, rows = describe(toy_folder).tables, all_rows(toy_folder)
    for behaviour in ("grasp", "push"):
        mine = [row for row in rows if row["behaviour"] == behaviour]
        use = Counter(digit for row in mine for digit in row["digits"])
        assert tables["digits"].row(behaviour) == {digit: use[digit] for digit in ("FF", "MF", "RF", "TH")}
        numbers = Counter(len(row["digits"]) for row in mine)
        assert tables["digit_numbers"].row(behaviour) == {str(n): numbers[n] for n in range(5)}
        azimuths = [math.degrees(math.atan2(row["q"][1], row["q"][0])) for row in mine]
        octants = tables["octants"].row(behaviour)
        assert octants["+x"] == sum(-22.5 < azimuth < 22.5 for azimuth in azimuths)
        assert octants["-y"] == sum(-112.5 < azimuth < -67.5 for azimuth in azimuths)
        assert sum(octants.values()) == len(mine)
    feasible = {
        (row["object"], k, n) for n, row in enumerate(rows) for k in range(16) if row["direction_margin"][k] >= 1
    }
    directions = tables["directions"]
    assert directions.header[1:4] == ("0", "22.5", "45")
    assert list(directions.row("rows").values()) == [sum(k == of for _, of, _ in feasible) for k in range(16)]
    objects = [len({name for name, of, _ in feasible if of == k}) for k in range(16)]
    assert list(directions.row("objects").values()) == objects


def test_contacts_are_counted_on_the_faces_that_they_touch(toy_folder):
    tables, rows = describe(toy_folder).tables, all_rows(toy_folder)
    for behaviour in ("grasp", "push"):
        contacts = [len(row["contact_points"]) for row in rows if row["behaviour"] == behaviour]
        assert len(contacts) <= sum(tables["faces"].row(behaviour).values()) <= sum(contacts)
    assert all(objects <= 3 for objects in tables["face_objects"].row("objects").values())


def test_spread_and_size(toy_folder):
    info, rows = describe(toy_folder), all_rows(toy_folder)
    margins = sorted(max(row["direction_margin"]) for row in rows if row["behaviour"] == "push")
    margin = info.tables["margin"].row("push")
    assert [row[0] for row in info.tables["margin"].rows] == ["push"]
    assert sum(info.tables["margin_bins"].row("push").values()) == len(margins)
    assert (margin["least"], margin["greatest"]) == pytest.approx((margins[0], margins[-1]), rel=5e-3)
    assert set(info.tables["penetration"].row("grasp").values()) == {0.2}  # mm
    assert set(info.tables["drift"].row("grasp").values()) == {4.0}  # mm
    assert info.tables["turn"].row("grasp")["median"] == pytest.approx(math.degrees(0.02), rel=5e-3)
    assert [row[0] for row in info.tables["drift"].rows] == ["grasp"]
    angles = np.degrees([row["q"][9:] for row in rows])
    expected = np.stack([angles.min(0), np.median(angles, 0), angles.max(0)], 1)
    np.testing.assert_allclose([row[1:4] for row in info.tables["joints"].rows], expected, atol=0.05 + 1e-6)
    files = [*toy_folder.glob("*.parquet"), toy_folder / "manifest.json"]
    assert info.bytes_on_disk == sum(file.stat().st_size for file in files)
    shards = sum(file.stat().st_size for file in toy_folder.glob("shard-*"))
    assert info.bytes_per_row == pytest.approx(shards / len(rows))


def test_joints_in_percent_of_the_hand_that_the_manifest_names(toy, tmp_path):
    hand, manifest = shadow_lite(), toy.toy_manifest(1)
    assert known_hand(manifest, tmp_path) is None  # nobody has a hand "toy"
    manifest.config = {"hand": "shadow_lite"}
    assert known_hand(manifest, tmp_path).joint_names == hand.joint_names
    toy.write_toy_dataset(tmp_path, num_objects=1, manifest=manifest)
    joints, rows = describe(tmp_path).tables["joints"], all_rows(tmp_path)
    angles = np.array([row["q"][9:] for row in rows])
    share = 100 * (angles.max(0) - hand.lower) / (hand.upper - hand.lower)
    np.testing.assert_allclose([row[-1] for row in joints.rows], share, atol=0.5 + 1e-6)


def test_an_empty_dataset_is_described(toy_folder):
    manifest = read_manifest(toy_folder)
    for shard in toy_folder.glob("shard-*"):
        shard.unlink()
    write_manifest(toy_folder, manifest)
    info = describe(toy_folder)
    assert (info.num_configurations, info.missing_objects, info.bytes_per_row) == (0, 3, 0.0)
    assert "margin" not in info.tables
    assert all(table.markdown() and table.html() for table in info.tables.values())


values = st.lists(st.floats(-1e4, 1e4, width=32), min_size=1, max_size=30)


@given(values)
def test_every_value_is_counted_once(numbers):
    bins, quantiles = histogram("length [mm]", {"a": np.array(numbers), "none": np.zeros(0)})
    assert sum(bins.row("a").values()) == len(numbers)
    assert [row[0] for row in bins.rows] == [row[0] for row in quantiles.rows] == ["a"]
    edges = round_edges(np.array(numbers))
    assert len(edges) <= BINS + 3
    assert (np.diff(edges) > 0).all()


def test_bins_and_quantiles():
    bins, quantiles = histogram("length [mm]", {"a": np.array([0.0, 0.05, 0.31, 1.2]), "b": np.array([0.55])})
    assert bins.title == "length [mm] from"
    assert bins.header[1:] == ("0", "0.1", "0.2", "0.3", "0.4", "0.5", "0.6", "0.7", "0.8", "0.9", "1", "1.1")
    assert bins.rows[0] == ("a", 2, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1)
    assert bins.rows[1] == ("b", 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0)
    assert quantiles.row("a") == pytest.approx(
        {"least": 0, "5 %": 0.0075, "median": 0.18, "95 %": 1.07, "greatest": 1.2}
    )


def test_a_single_value_gets_one_bin():
    edges = round_edges(np.array([3.0, 3.0]))
    assert edges[0] <= 3.0 <= edges[-1]
    assert len(edges) == 2
