"""Properties that the architecture must have whatever its weights."""

import dataclasses
from typing import get_args

import pytest
import torch

from dexnudge.diffusion.config import Architecture, ModelConfig, TokenLayout, check_choice, token_parts
from dexnudge.diffusion.network import (
    GRASP,
    NON_PREHENSILE,
    POINT_SCALE,
    ConditionalDenoiser,
    timestep_features,
)
from dexnudge.diffusion.schedule import NoiseSchedule
from dexnudge.errors import CheckpointError, InputError, UnknownNameError


def inputs(config, feature, num=5, behaviour=NON_PREHENSILE, twist=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0), t=300):
    x_t = torch.randn(num, config.dimension, generator=torch.Generator().manual_seed(4))
    rows = len(feature)
    return [
        x_t,
        torch.full((rows,), t),
        feature,
        torch.full((rows,), behaviour),
        torch.tensor(twist or (0.0,) * 6).expand(rows, 6),
        torch.full((rows,), twist is not None),
    ]


def test_an_untrained_network_returns_zero_whatever_the_condition(untrained, config, points):
    for arguments in (
        inputs(config, untrained.encode(points)),
        inputs(config, untrained.encode(2.0 * points), behaviour=GRASP, twist=None, t=1),
    ):
        assert torch.equal(untrained(*arguments), torch.zeros(5, config.dimension))


def test_blocks_are_the_identity_at_first(untrained):
    tokens, zero = torch.randn(3, 6, 32), torch.zeros(3, 1, 32)
    assert torch.equal(untrained.blocks[0](tokens, *[zero] * 6), tokens)


def test_every_condition_matters_once_trained(network, config, points):
    feature = network.encode(points)
    base = network(*inputs(config, feature))
    for changed in (
        inputs(config, feature, behaviour=GRASP),
        inputs(config, feature, twist=(0.0, 1.0, 0.0, 0.0, 0.0, 0.0)),
        inputs(config, feature, twist=None),
        inputs(config, feature, t=301),
        inputs(config, network.encode(1.1 * points)),
    ):
        assert (network(*changed) - base).abs().max() > 1e-4


def test_a_direction_that_does_not_count_is_not_seen(network, config, points):
    arguments = inputs(config, network.encode(points), twist=None)
    base = network(*arguments)
    arguments[4] = torch.tensor([[0.3, 0.4, 0.5, 0.6, 0.7, 0.8]])
    assert torch.equal(network(*arguments), base)


def test_one_condition_row_serves_all_samples(network, config, points):
    shared = inputs(config, network.encode(points))
    repeated = [shared[0], *[value.expand(5, *value.shape[1:]) for value in shared[1:]]]
    torch.testing.assert_close(network(*shared), network(*repeated), atol=1e-5, rtol=1e-5)


def test_samples_do_not_see_each_other(network, config, points):
    arguments = inputs(config, network.encode(points))
    together = network(*arguments)
    alone = network(arguments[0][2:3], *arguments[1:])
    torch.testing.assert_close(together[2:3], alone, atol=1e-5, rtol=1e-5)


def test_point_order_does_not_matter(network, points):
    shuffled = points[:, torch.randperm(points.shape[1], generator=torch.Generator().manual_seed(0))]
    torch.testing.assert_close(network.encode(points), network.encode(shuffled))


def test_support_function_against_a_loop(network, points):
    directions = network.encoder.support_directions
    for k in range(directions.shape[1]):
        u = directions[:, k].double()
        reach = max(float(p.double() @ u) for p in points[0, :, :3])
        found = (points[0, :, :3] * POINT_SCALE @ directions).amax(dim=0)[k] / POINT_SCALE
        assert float(found) == pytest.approx(reach, abs=1e-6)
        assert float(u.norm()) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("layout", get_args(TokenLayout))
def test_joint_order_is_only_a_name(config, points, layout):
    """The same digits, their joints stored in another order: same function, entries permuted alike."""
    torch.manual_seed(0)
    config = dataclasses.replace(config, architecture=dataclasses.replace(config.architecture, token_layout=layout))
    network = ConditionalDenoiser(config)
    for layer in (network.modulation, *network.token_out):
        torch.nn.init.normal_(layer.weight, std=0.1)
    permutation = torch.randperm(16, generator=torch.Generator().manual_seed(5))
    inverse = torch.argsort(permutation).tolist()
    renamed = dataclasses.replace(
        config,
        joint_names=tuple(config.joint_names[k] for k in permutation.tolist()),
        joint_groups=tuple(tuple(inverse[joint] for joint in digit) for digit in config.joint_groups),
    )
    other = ConditionalDenoiser(renamed)
    other.load_state_dict(network.state_dict())
    arguments = inputs(config, network.encode(points))
    columns = torch.cat([torch.arange(9), 9 + permutation])
    found = other(arguments[0][:, columns], *arguments[1:])
    torch.testing.assert_close(found, network(*arguments)[:, columns])


@pytest.mark.parametrize(("layout", "tokens"), [("digits", 6), ("single", 1), ("scalars", 25)])
def test_every_layout_starts_at_zero_and_sees_every_entry(config, points, layout, tokens):
    torch.manual_seed(0)
    shape = dataclasses.replace(config.architecture, token_layout=layout)
    network = ConditionalDenoiser(dataclasses.replace(config, architecture=shape))
    assert network.token_position.shape == (tokens, shape.width)
    feature = network.encode(points)
    arguments = inputs(config, feature)
    assert torch.equal(network(*arguments), torch.zeros(5, config.dimension))
    for layer in (network.modulation, *network.token_out):
        torch.nn.init.normal_(layer.weight, std=0.1)
    x_t = arguments[0][:1].requires_grad_()
    jacobian = torch.autograd.functional.jacobian(lambda x: network(x, *arguments[1:])[0], x_t)[:, 0]
    assert (jacobian.abs() > 0.0).all()


@pytest.mark.parametrize("layout", get_args(TokenLayout))
def test_tokens_hold_each_entry_once(config, layout):
    parts = token_parts(layout, config.joint_groups)
    assert sorted(index for part in parts for index in part) == list(range(config.dimension))


def test_digits_of_different_sizes(points):
    config = ModelConfig(
        hand="odd",
        joint_names=tuple("abcdef"),
        joint_groups=((5,), (0, 1, 2), (4, 3)),
        architecture=Architecture(width=16, depth=1, num_heads=2),
    )
    network = ConditionalDenoiser(config)
    assert network(*inputs(config, network.encode(points))).shape == (5, 15)


def test_timesteps_are_told_apart():
    features = timestep_features(torch.arange(1000))
    distances = torch.cdist(features[None], features[None])[0] + torch.eye(1000) * 9.0
    assert distances.min() > 0.1


def test_the_default_model_fits_into_ten_megabytes(config):
    network = ConditionalDenoiser(dataclasses.replace(config, architecture=Architecture()))
    assert 2 * sum(parameter.numel() for parameter in network.parameters()) < 10e6


def test_impossible_shapes_are_refused(config):
    with pytest.raises(InputError, match="`width` 30 is not a multiple of `num_heads` 4"):
        Architecture(width=30)
    with pytest.raises(UnknownNameError, match="unknown token layout 'words'; expected one of digits, single, scalars"):
        check_choice("token_layout", "words")
    with pytest.raises(InputError, match="zero_terminal_snr cannot be used with epsilon prediction"):
        Architecture(prediction_type="epsilon", zero_terminal_snr=True)
    with pytest.raises(CheckpointError, match="do not cover each of the 16 joints exactly once"):
        dataclasses.replace(config, joint_groups=config.joint_groups[:3])


def test_the_last_step_follows_the_prediction_type():
    kinds = ("epsilon", "sample", "v_prediction")
    last = {kind: NoiseSchedule(Architecture(prediction_type=kind)) for kind in kinds}
    assert [float(schedule.alphas_cumprod[-1]) == 0.0 for schedule in last.values()] == [False, True, True]
    kept = Architecture(zero_terminal_snr=False)
    assert float(NoiseSchedule(kept).alphas_cumprod[-1]) > 0.0
