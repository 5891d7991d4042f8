"""The margins of turns: a column that newer shards have and older ones lack."""

import dataclasses
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest

from dexnudge.dataset.loading import load_dataset, load_datasets
from dexnudge.dataset.manifest import write_manifest
from dexnudge.dataset.schema import INFEASIBLE, MARGIN_STEP, TURNS, BehaviourCounts
from dexnudge.dataset.shards import column_matrix, read_shard, shard_path, write_shard, write_turns
from dexnudge.errors import DatasetError

NAME = "object-0"


@pytest.fixture
def margin():
    rng = np.random.default_rng(1)
    return np.where(rng.random((3, len(TURNS))) < 0.5, rng.uniform(0.0, 3.0, (3, len(TURNS))), INFEASIBLE)


@pytest.fixture
def twists():
    twists = np.random.default_rng(2).normal(size=(len(TURNS), 6))
    twists[4] = np.nan  # no such edge
    return twists


@pytest.fixture
def manifest(toy):
    return toy.toy_manifest(1)


def write(toy, manifest, folder, margin=None, twists=None):
    rng = np.random.default_rng(0)
    rows = [toy.toy_row(rng, "push") for _ in range(3)]
    if margin is not None:
        rows = [dataclasses.replace(row, turn_margin=each) for row, each in zip(rows, margin, strict=True)]
    counts = {"push": BehaviourCounts(attempted=3, kept=3)}
    write_manifest(folder, manifest)
    write_shard(folder, manifest, NAME, rows, toy.toy_cloud(rng), counts, twists)


def test_round_trip(toy, manifest, tmp_path, margin, twists):
    write(toy, manifest, tmp_path, margin, twists)
    shard = read_shard(tmp_path, manifest, NAME)
    np.testing.assert_array_equal(shard.turns, twists)
    lost = margin - column_matrix(shard.table, "turn_margin")
    assert (lost >= 0.0).all()
    assert lost.max() < MARGIN_STEP
    dataset = load_dataset(tmp_path)
    np.testing.assert_array_equal(dataset.turn_margin, column_matrix(shard.table, "turn_margin"))
    np.testing.assert_allclose(dataset.turns[0], twists, rtol=1e-6)


def test_without_them_the_file_is_as_it_was(toy, manifest, tmp_path):
    write(toy, manifest, tmp_path)
    assert "turn_margin" not in pq.read_schema(shard_path(tmp_path, NAME)).names
    assert read_shard(tmp_path, manifest, NAME).turns is None
    dataset = load_dataset(tmp_path)
    assert (dataset.turn_margin == INFEASIBLE).all()
    assert np.isnan(dataset.turns).all()


def test_margins_written_later_equal_those_written_at_once(toy, manifest, tmp_path, margin, twists):
    for folder in ("later", "at_once"):
        (tmp_path / folder).mkdir()
    write(toy, manifest, tmp_path / "at_once", margin, twists)
    write(toy, manifest, tmp_path / "later")
    write_turns(tmp_path / "later", manifest, read_shard(tmp_path / "later", manifest, NAME), margin, twists)
    files = [shard_path(tmp_path / folder, NAME).read_bytes() for folder in ("later", "at_once")]
    assert files[0] == files[1]


def test_datasets_are_read_as_one(toy, tmp_path):
    toy.write_toy_dataset(tmp_path / "a", num_objects=2, seed=0)
    toy.write_toy_dataset(tmp_path / "b", num_objects=3, seed=1)
    parts = [load_dataset(tmp_path / name) for name in ("a", "b")]
    both = load_datasets([tmp_path / "a", tmp_path / "b"])
    assert both.object_names == parts[0].object_names + parts[1].object_names
    np.testing.assert_array_equal(both.q, np.concatenate([part.q for part in parts]))
    np.testing.assert_array_equal(both.object_index[len(parts[0]) :], parts[1].object_index + 2)
    np.testing.assert_array_equal(both.clouds[2:], parts[1].clouds)


def test_a_dataset_that_is_given_twice_is_refused(toy, tmp_path):
    toy.write_toy_dataset(tmp_path / "a", num_objects=2, seed=0)
    toy.write_toy_dataset(tmp_path / "b", num_objects=3, seed=1)
    (tmp_path / "link").symlink_to(tmp_path / "a")
    shutil.copytree(tmp_path / "a", tmp_path / "copy")
    for again in ("a", "b/../a", "link", "copy"):
        with pytest.raises(
            DatasetError, match=r"holds the same \d+ configurations of object-0 as .*a; expected each dataset"
        ):
            load_datasets([tmp_path / "a", tmp_path / "b", tmp_path / again])


def test_datasets_of_two_hands_are_refused(toy, tmp_path):
    toy.write_toy_dataset(tmp_path / "a")
    toy.write_toy_dataset(tmp_path / "b", manifest=dataclasses.replace(toy.toy_manifest(), hand="other"))
    with pytest.raises(DatasetError, match=r"b is of hand 'other', .*a of 'toy'; expected datasets of one hand"):
        load_datasets([tmp_path / "a", tmp_path / "b"])
    with pytest.raises(DatasetError, match="expected at least one folder"):
        load_datasets([])
