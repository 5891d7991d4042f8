"""A manifest made anew holds what the shards say, and nothing of copies beside them."""

import shutil
from dataclasses import replace

from dexnudge.dataset.manifest import read_manifest
from dexnudge.dataset.shards import shard_path
from dexnudge.synthesis.rebuilt_manifest import rebuilt_manifest


def test_copies_under_other_names_are_passed_over(toy_folder):
    manifest = read_manifest(toy_folder)
    alone = rebuilt_manifest(toy_folder, manifest)
    assert replace(alone, counts={}) == replace(manifest, counts={})
    assert alone.counts["grasp"]["attempted"] == 11 * len(manifest.objects)
    path = shard_path(toy_folder, "object-0")
    for name in ("shard-object-0 (copy).parquet", "shard-another.parquet"):
        shutil.copy(path, toy_folder / name)
    assert rebuilt_manifest(toy_folder, manifest) == alone


def test_a_damaged_shards_object_is_still_to_be_generated(toy_folder):
    shard_path(toy_folder, "object-1").write_bytes(b"PAR1")
    manifest = read_manifest(toy_folder)
    rebuilt = rebuilt_manifest(toy_folder, manifest)
    assert rebuilt.objects == {**manifest.objects, "object-1": None}
