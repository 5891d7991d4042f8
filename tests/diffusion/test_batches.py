"""Batches hold what the dataset says, turned so that the motion is +x."""

import dataclasses

import numpy as np
import pytest
import torch

from dexnudge.dataset.loading import load_dataset
from dexnudge.dataset.schema import BEHAVIOURS
from dexnudge.diffusion.batches import BatchSampler
from dexnudge.diffusion.config import TrainingConfig
from dexnudge.diffusion.network import GRASP, NON_PREHENSILE, NULL_CLASS
from dexnudge.errors import DatasetError

ROWS = 5
PLAIN = TrainingConfig(
    groups=40,
    rows_per_group=ROWS,
    unconditional_fraction=0.0,
    direction_dropout=0.0,
    behaviour_dropout=0.0,
    point_noise=0.0,
    scale_jitter=0.0,
)


@pytest.fixture(scope="module")
def dataset(toy, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    toy.write_toy_dataset(folder, num_objects=4, rows=30)
    return load_dataset(folder)


def row_and_yaw(dataset, q):
    """Which row a turned configuration came from (joint angles are unique), and by how much it was turned."""
    row = int(np.flatnonzero((dataset.q[:, 9:] == q[9:].numpy()).all(axis=1))[0])
    turned, original = complex(*q[:2].tolist()), complex(*dataset.q[row, :2].tolist())
    return row, float(np.angle(turned / original))


def test_configurations_can_move_the_object_along_x(dataset):
    batch = BatchSampler(dataset, range(4), PLAIN).batch(0)
    seen = set()
    for index, q in enumerate(batch.q):
        row, yaw = row_and_yaw(dataset, q)
        group = index // ROWS
        if batch.behaviour[group] == GRASP:
            assert dataset.behaviour[row] == BEHAVIOURS.index("grasp")
            assert not batch.has_twist[group]
            continue
        step = 2.0 * np.pi / 16
        direction = round(-yaw / step) % 16
        assert abs((-yaw - direction * step + np.pi) % (2.0 * np.pi) - np.pi) <= PLAIN.yaw_jitter + 1e-5
        assert dataset.direction_margin[row, direction] >= 1.0
        assert batch.has_twist[group]
        assert batch.twist[group].tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        seen.add(direction)
    assert len(seen) > 8


def test_the_object_turns_with_the_hand(dataset):
    batch = BatchSampler(dataset, range(4), PLAIN).batch(1)
    for group in range(PLAIN.groups):
        rows = [row_and_yaw(dataset, q) for q in batch.q[group * ROWS : (group + 1) * ROWS]]
        objects = {int(dataset.object_index[row]) for row, _ in rows}
        assert len(objects) == 1
        cloud = torch.from_numpy(dataset.clouds[objects.pop()])
        yaw = rows[0][1]
        turn = torch.tensor([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]], dtype=torch.float32)
        turned = cloud[:, :2] @ turn.T
        nearest = torch.cdist(batch.points[group, :, :2][None], turned[None])[0].amin(dim=1)
        assert nearest.max() < 1e-4


def test_the_cloud_alone_is_scaled_about_the_origin(dataset):
    plain = BatchSampler(dataset, range(4), PLAIN).batch(2)
    scaled = BatchSampler(dataset, range(4), dataclasses.replace(PLAIN, scale_jitter=0.02)).batch(2)
    assert torch.equal(scaled.q, plain.q)
    assert torch.equal(scaled.points[..., 3:], plain.points[..., 3:])
    ratio = scaled.points[..., :3].flatten(1).norm(dim=1) / plain.points[..., :3].flatten(1).norm(dim=1)
    torch.testing.assert_close(scaled.points[..., :3], ratio[:, None, None] * plain.points[..., :3])
    assert 0.98 <= ratio.min() < 0.985  # of 40 uniform draws
    assert 1.015 < ratio.max() <= 1.02


def test_a_batch_depends_on_seed_stream_and_index_alone(dataset):
    first, second = BatchSampler(dataset, range(4), PLAIN), BatchSampler(dataset, range(4), PLAIN)
    for index in range(3):
        first.batch(index)
    assert torch.equal(first.batch(3).q, second.batch(3).q)
    assert torch.equal(first.batch(3).points, second.batch(3).points)
    assert not torch.equal(first.batch(3).q, second.batch(4).q)
    assert not torch.equal(first.batch(3).q, second.batch(3, stream=1).q)


def test_shares_of_dropped_conditions(dataset):
    config = dataclasses.replace(
        PLAIN,
        groups=2000,
        rows_per_group=1,
        num_points=1,
        grasp_fraction=0.3,
        unconditional_fraction=0.1,
        direction_dropout=0.2,
        behaviour_dropout=0.15,
    )
    batch = BatchSampler(dataset, range(4), config).batch(0)
    null = float((batch.behaviour == NULL_CLASS).float().mean())
    directed = float(batch.has_twist.float().mean())
    assert null == pytest.approx(1.0 - 0.9 * 0.85, abs=0.04)  # four standard errors of 2000 draws
    assert directed == pytest.approx(0.7 * 0.9 * 0.8, abs=0.045)
    assert not batch.twist[~batch.has_twist].any()
    assert float((batch.behaviour == GRASP).float().mean()) == pytest.approx(0.3 * 0.9 * 0.85, abs=0.04)


def test_one_kind_only(dataset):
    grasps = BatchSampler(dataset, range(4), dataclasses.replace(PLAIN, grasp_fraction=1.0)).batch(0)
    assert (grasps.behaviour == GRASP).all()
    moves = BatchSampler(dataset, range(4), dataclasses.replace(PLAIN, grasp_fraction=0.0)).batch(0)
    assert (moves.behaviour == NON_PREHENSILE).all()


def test_only_the_given_objects_are_used(dataset):
    batch = BatchSampler(dataset, [2], PLAIN).batch(0)
    assert {int(dataset.object_index[row_and_yaw(dataset, q)[0]]) for q in batch.q} == {2}


def test_nothing_to_train_on(dataset):
    config = dataclasses.replace(PLAIN, grasp_fraction=0.0, min_direction_margin=3.0)
    with pytest.raises(DatasetError, match="none of 4 objects has a configuration to train on"):
        BatchSampler(dataset, range(4), config)


def test_rare_behaviours_are_drawn_as_often_as_common_ones(dataset):
    """Three quarters of the pushes are called presses; feasibility still counts."""
    behaviour = dataset.behaviour.copy()
    pushes = np.flatnonzero(behaviour == BEHAVIOURS.index("push"))
    behaviour[pushes[np.arange(len(pushes)) % 4 > 0]] = BEHAVIOURS.index("press")
    everywhere = np.where(behaviour[:, None] == BEHAVIOURS.index("grasp"), -1.0, 2.0).astype(np.float32)
    relabelled = dataclasses.replace(dataset, behaviour=behaviour, direction_margin=np.repeat(everywhere, 16, axis=1))
    for balance, share in ((0.0, 0.25), (1.0, 0.5)):
        config = dataclasses.replace(PLAIN, grasp_fraction=0.0, rows_per_group=50, behaviour_balance=balance)
        q = BatchSampler(relabelled, range(4), config).batch(0).q
        rows = [row_and_yaw(relabelled, sample)[0] for sample in q]
        found = np.mean(behaviour[rows] == BEHAVIOURS.index("push"))
        assert found == pytest.approx(share, abs=0.05)  # four standard errors of 2000 draws, and uneven objects
