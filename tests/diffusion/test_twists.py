"""The prior's condition is a twist in frame C; networks from before twists draw what they drew."""

import dataclasses
import json

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from scipy.spatial.transform import Rotation

from dexnudge.dataset.loading import load_dataset
from dexnudge.dataset.schema import TURNS
from dexnudge.diffusion.batches import BatchSampler
from dexnudge.diffusion.checkpoint import CONFIG_NAME, SHIPPED_WEIGHTS, WEIGHTS_NAME, load_model, save_model
from dexnudge.diffusion.config import TrainingConfig
from dexnudge.diffusion.prior import SLIDE, DiffusionPrior
from dexnudge.errors import CheckpointError
from dexnudge.geometry.transforms import canonical_frame
from dexnudge.objects.builtin import builtin_object
from dexnudge.scenes.motion import Turn, Twist
from dexnudge.scenes.scene import Scene
from dexnudge.synthesis.acceptance import resting_scene

TIP = Twist(np.array([0.4, 0.0, 0.3]), np.array([0.0, 6.0, 0.0]))


@pytest.fixture
def turning(network):
    """The network after some training on turns."""
    with torch.no_grad():
        network.turn_embedding.normal_(generator=torch.Generator().manual_seed(5))
    return network


def as_written_before_twists(folder):
    tensors = load_file(folder / WEIGHTS_NAME)
    del tensors["network.turn_embedding"]
    save_file(tensors, folder / WEIGHTS_NAME)
    content = json.loads((folder / CONFIG_NAME).read_text())
    content["model"]["config_version"] = 1
    content["weights_sha256"] = _digest(folder)
    (folder / CONFIG_NAME).write_text(json.dumps(content))


def _digest(folder):
    import hashlib

    return hashlib.sha256((folder / WEIGHTS_NAME).read_bytes()).hexdigest()


def test_an_old_checkpoint_gives_equal_outputs(network, normaliser, config, points, tmp_path):
    save_model(tmp_path, config, network.state_dict(), normaliser, dtype=torch.float32)
    as_written_before_twists(tmp_path)
    prior, loaded = DiffusionPrior(network, normaliser), DiffusionPrior(*load_model(tmp_path))
    x_t = prior.noise(6, generator=torch.Generator().manual_seed(0))
    for behaviour in ("grasp", "non_prehensile"):
        expected = prior.predict_clean(x_t, 400, prior.condition(points, behaviour))
        assert torch.equal(loaded.predict_clean(x_t, 400, loaded.condition(points, behaviour)), expected)


def test_a_new_checkpoint_without_its_columns_is_damaged(network, normaliser, config, tmp_path):
    save_model(tmp_path, config, network.state_dict(), normaliser)
    as_written_before_twists(tmp_path)
    content = json.loads((tmp_path / CONFIG_NAME).read_text())
    content["model"]["config_version"] = 2
    (tmp_path / CONFIG_NAME).write_text(json.dumps(content))
    with pytest.raises(CheckpointError, match="turn_embedding has shape no entry"):
        load_model(tmp_path)


@pytest.mark.parametrize("hand", sorted(path.name for path in SHIPPED_WEIGHTS.iterdir() if path.is_dir()))
def test_shipped_weights_load(hand):
    network, _ = load_model(SHIPPED_WEIGHTS / hand)
    assert network.turn_embedding.shape == (network.config.architecture.width, 3)


def test_columns_of_the_angular_part_change_nothing_of_a_slide(network, normaliser, points):
    prior = DiffusionPrior(network, normaliser)
    x_t = prior.noise(6, generator=torch.Generator().manual_seed(0))
    before = prior.predict_clean(x_t, 400, prior.condition(points))
    with torch.no_grad():
        network.turn_embedding.normal_(generator=torch.Generator().manual_seed(5))
    assert torch.equal(prior.predict_clean(x_t, 400, prior.condition(points)), before)
    rounded = Twist(np.array([1.0 - 1e-16, 1e-17, 0.0]), np.zeros(3))  # as it comes out of a rotation
    assert torch.equal(prior.predict_clean(x_t, 400, prior.condition(points, twist=rounded)), before)
    tipping = prior.predict_clean(x_t, 400, prior.condition(points, twist=TIP))
    assert (tipping - before).abs().max() > 1e-3


def test_weights_that_know_slides_only_are_not_asked_for_turns(network, normaliser, points):
    prior = DiffusionPrior(network, normaliser)
    assert not prior.condition(points, twist=TIP).has_twist.any()
    assert prior.condition(points, twist=SLIDE).has_twist.all()


def test_a_condition_turns_with_its_scene():
    """Object, surroundings, heading and axis moved together: frame C sees the same twist."""
    lying = resting_scene(builtin_object("phone"))
    turn = Turn(0.5, np.array([0.2, 1.0, 0.0]), np.array([0.03, 0.0, -0.005]))

    def seen(yaw: float) -> Twist:
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
        T[:3, 3] = [0.3 * yaw, -0.1, 0.2]
        moved = dataclasses.replace(turn, axis=T[:3, :3] @ turn.axis, point=T[:3, :3] @ turn.point + T[:3, 3])
        scene = Scene(lying.object_mesh, lying.environment_mesh, T, T[:3, :3] @ [0.6, 0.8, 0.0], turn=moved)
        frame = canonical_frame(scene.object_in_world(), scene.motion)
        return scene.object_motion.twist().moved(np.linalg.inv(frame))

    first, other = seen(0.0), seen(2.0)
    np.testing.assert_allclose(other.linear, first.linear, atol=1e-9)
    np.testing.assert_allclose(other.angular, first.angular, atol=1e-9)
    assert np.linalg.norm(first.angular) > 1.0


def test_batches_hold_hands_that_can_make_the_turn(toy, tmp_path):
    """Rows, cloud and twist are turned alike: each group's twist, turned back, is one that its rows are feasible for."""
    toy.write_toy_dataset(tmp_path, num_objects=4, rows=30)
    plain = load_dataset(tmp_path)
    rng = np.random.default_rng(0)
    twists = rng.normal(size=(4, len(TURNS), 6)).astype(np.float32)
    twists[:, :2, :5] = 0.0  # in place
    twists[:, 2:, 5] = 0.0  # about a horizontal axis
    margin = np.where(rng.random((len(plain), len(TURNS))) < 0.5, 2.0, -1.0).astype(np.float32)
    dataset = dataclasses.replace(plain, turn_margin=margin, turns=twists)
    config = TrainingConfig(
        groups=200,
        rows_per_group=3,
        grasp_fraction=0.0,
        turn_fraction=0.5,
        unconditional_fraction=0.0,
        direction_dropout=0.0,
        yaw_jitter=0.0,
    )
    batch = BatchSampler(dataset, range(4), config).batch(0)
    turned = batch.twist[:, 3:].abs().sum(dim=1) > 0
    assert 0.4 < float(turned.float().mean()) < 0.6
    assert batch.has_twist.all()
    headed = 0
    for group in np.flatnonzero(turned.numpy()):
        for q in batch.q[3 * group : 3 * group + 3]:
            row = int(np.flatnonzero((dataset.q[:, 9:] == q[9:].numpy()).all(axis=1))[0])
            yaw = np.angle(complex(*q[:2].tolist()) / complex(*dataset.q[row, :2].tolist()))
            R = Rotation.from_euler("z", -yaw).as_matrix()
            resting = np.concatenate([R @ batch.twist[group, :3].numpy(), R @ batch.twist[group, 3:].numpy()])
            away = np.abs(twists[dataset.object_index[row]] - resting).max(axis=1)
            chosen = int(np.argmin(away))
            assert away[chosen] < 1e-4
            assert margin[row, chosen] == 2.0
        linear_y = float(batch.twist[group, 3])  # of the axis along the heading
        headed += bool(chosen >= 2 and abs(linear_y) < 1e-4 and batch.twist[group, 4] > 0)
    assert 0.5 < headed / int(turned.sum()) < 0.7  # 8 of 10 turns tip, 0.7 of them along x


def test_a_dataset_without_turns_has_the_batches_that_it_had(toy, tmp_path):
    toy.write_toy_dataset(tmp_path, num_objects=4, rows=30)
    dataset = load_dataset(tmp_path)
    first, other = (
        BatchSampler(dataset, range(4), TrainingConfig(turn_fraction=share)).batch(3) for share in (0.0, 0.5)
    )
    assert torch.equal(first.q, other.q)
    assert torch.equal(first.twist, other.twist)
