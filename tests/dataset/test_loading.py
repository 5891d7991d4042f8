"""A loaded dataset equals its shards, and holes in it are reported."""

import dataclasses

import numpy as np
import pytest

from dexnudge.dataset.loading import load_dataset
from dexnudge.dataset.manifest import write_manifest
from dexnudge.dataset.schema import BEHAVIOURS
from dexnudge.dataset.shards import column_matrix, read_cloud, read_shard, shard_path
from dexnudge.errors import DatasetError
from dexnudge.jobs.atomic_files import TEMPORARY_PREFIX


def test_rows_point_to_their_object(toy, toy_folder):
    dataset = load_dataset(toy_folder)
    assert len(dataset) == 36
    for index, name in enumerate(dataset.object_names):
        shard = read_shard(toy_folder, dataset.manifest, name)
        rows = dataset.object_index == index
        np.testing.assert_array_equal(dataset.q[rows], column_matrix(shard.table, "q"))
        np.testing.assert_array_equal(dataset.direction_margin[rows], column_matrix(shard.table, "direction_margin"))
        labels = [BEHAVIOURS[k] for k in dataset.behaviour[rows]]
        assert labels == shard.table.column("behaviour").to_pylist()
        np.testing.assert_array_equal(dataset.clouds[index], read_cloud(toy_folder, dataset.manifest, name))


def test_leftovers_of_killed_writers_are_not_data(toy_folder):
    before = load_dataset(toy_folder)
    (toy_folder / f"{TEMPORARY_PREFIX}123-shard-object-9.parquet").write_bytes(b"half a shard")
    np.testing.assert_array_equal(load_dataset(toy_folder).q, before.q)


def test_an_unfinished_dataset_is_refused_unless_allowed(toy_folder):
    shard_path(toy_folder, "object-1").unlink()
    with pytest.raises(DatasetError, match=r"incomplete: 1 of 3 objects have no shard \(first: object-1\)"):
        load_dataset(toy_folder)
    assert load_dataset(toy_folder, allow_incomplete=True).object_names == ("object-0", "object-2")


def test_a_failed_object_is_no_hole(toy, toy_folder):
    shard_path(toy_folder, "object-1").unlink()
    write_manifest(toy_folder, dataclasses.replace(toy.toy_manifest(), failed_objects={"object-1": "not watertight"}))
    assert load_dataset(toy_folder).object_names == ("object-0", "object-2")


def test_an_empty_dataset_is_refused(toy, tmp_path):
    toy.write_toy_dataset(tmp_path, rows=0)
    with pytest.raises(DatasetError, match="holds no configuration"):
        load_dataset(tmp_path)
