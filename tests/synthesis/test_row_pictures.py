"""Pictures of rows, drawn with the real hand and a real object."""

import numpy as np
import pytest
import trimesh

from dexnudge.dataset.manifest import read_manifest, write_manifest
from dexnudge.dataset.schema import BehaviourCounts
from dexnudge.dataset.shards import read_shard, write_shard
from dexnudge.errors import DatasetError
from dexnudge.objects.builtin import builtin_object
from dexnudge.synthesis.dataset_page import (
    SAMPLES,
    draw_samples,
    pick_rows,
    row_caption,
    row_drawing,
)
from dexnudge.synthesis.object_data import ObjectMeshes, at_rest, mesh_hash

NAME = "phone-200"
TILE = (280, 240)  # pixels: enough to see what is drawn


@pytest.fixture
def manifest(toy, tmp_path):
    """One push and one grasp of a built-in phone; the poses are random."""
    made = toy.toy_manifest(0)
    made.hand, made.config = "shadow_lite", {"hand": "shadow_lite", "length": None}
    made.objects = {NAME: mesh_hash(builtin_object(NAME))}
    rng = np.random.default_rng(5)
    rows = [toy.toy_row(rng, behaviour) for behaviour in ("push", "grasp")]
    counts = {behaviour: BehaviourCounts(attempted=1, kept=1) for behaviour in ("push", "grasp")}
    write_manifest(tmp_path, made)
    write_shard(tmp_path, made, NAME, rows, toy.toy_cloud(rng), counts)
    return made


def test_pictures_of_a_grasp_and_a_push(manifest, tmp_path, monkeypatch):
    monkeypatch.setattr("dexnudge.synthesis.dataset_page.TILE", TILE)
    samples = draw_samples(tmp_path)
    assert [sample.behaviour for sample in samples] == ["grasp", "push"]
    values = {row["behaviour"]: row for row in read_shard(tmp_path, manifest, NAME).table.to_pylist()}
    for sample in samples:
        assert sample.caption == row_caption(values[sample.behaviour])
        assert sample.picture.shape == (TILE[1], TILE[0], 3)
        red, green, blue = (sample.picture[..., channel].astype(int) for channel in range(3))
        assert ((red > green + 60) & (green > blue)).sum() > 100  # the object is orange
        arrow = ((green > red + 30) & (green > blue + 20)).sum()
        assert (arrow > 100) == (sample.behaviour == "push")
    again = draw_samples(tmp_path)
    assert all((one.picture == other.picture).all() for one, other in zip(samples, again, strict=True))


def test_the_arrow_points_along_the_best_margin_and_grasps_float(hand, manifest, tmp_path):
    mesh = at_rest(builtin_object(NAME))
    push, grasp = read_shard(tmp_path, manifest, NAME).table.to_pylist()
    shown = row_drawing(hand, mesh, push)
    best = int(np.argmax(push["direction_margin"]))
    angle = np.radians(22.5 * best)
    np.testing.assert_allclose(shown.motion, [np.cos(angle), np.sin(angle), 0.0], atol=1e-12)
    assert row_caption(push)[1] == f"margin {push['direction_margin'][best]:.2f} along {22.5 * best:g}°"
    plane = shown.with_role("environment")[0].vertices_in_world()
    assert plane[:, 2].max() == pytest.approx(mesh.bounds[0, 2])
    floating = row_drawing(hand, mesh, grasp)
    assert not floating.with_role("environment", "base")
    assert len(floating.arrow().mesh.faces) == 0
    assert row_caption(grasp)[1] == "drift 4.0 mm, 1.1° when held"
    np.testing.assert_allclose(floating.contacts, grasp["contact_points"])


def test_among_equal_margins_the_arrow_points_along_the_middle(hand, manifest, tmp_path):
    push, _ = read_shard(tmp_path, manifest, NAME).table.to_pylist()
    push["direction_margin"] = [3.0 if direction in (14, 15, 0, 1, 2, 7) else 1.5 for direction in range(16)]
    assert row_caption(push)[1] == "margin 3.00 along 0°"
    shown = row_drawing(hand, at_rest(builtin_object(NAME)), push)
    np.testing.assert_allclose(shown.motion, [1.0, 0.0, 0.0], atol=1e-12)


def test_another_mesh_or_none_is_refused(manifest, tmp_path):
    box = trimesh.creation.box((0.15, 0.07, 0.01))
    box.export(tmp_path / f"{NAME}.stl")
    with pytest.raises(
        DatasetError, match=f"the mesh of '{NAME}' in .*stl is not the one that the dataset was generated from"
    ):
        ObjectMeshes(manifest, str(tmp_path / f"{NAME}.stl")).at_rest(NAME, manifest.objects[NAME])
    with pytest.raises(
        DatasetError, match=rf"'{NAME}' of the built-in object with that name is not .* give it as `objects`"
    ):
        ObjectMeshes(manifest, None).at_rest(NAME, "of another mesh")
    with pytest.raises(DatasetError, match=r"is not in the built-in objects.*`objects`"):
        ObjectMeshes(manifest, None).at_rest("cup", "")
    with pytest.raises(DatasetError, match=r"the mesh of 'cup' is not in .*stl; expected the set"):
        ObjectMeshes(manifest, str(tmp_path / f"{NAME}.stl")).at_rest("cup", "")


def test_rows_are_picked_once_each_and_by_the_seed(toy, tmp_path):
    manifest = toy.write_toy_dataset(tmp_path)
    picked = [pick_rows(tmp_path, manifest, np.random.default_rng(seed)) for seed in (0, 0, 1)]
    assert picked[0] == picked[1] != picked[2]
    assert len(set(picked[0])) == 2 * SAMPLES  # grasps and pushes
    labels = [
        read_shard(tmp_path, read_manifest(tmp_path), name).table.column("behaviour")[row].as_py()
        for name, row in picked[0]
    ]
    assert labels == ["grasp"] * SAMPLES + ["push"] * SAMPLES
