"""What a sampler relies on."""

import pytest
import torch

from dexnudge.diffusion.checkpoint import save_model
from dexnudge.diffusion.network import NULL_CLASS
from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.errors import CheckpointError, UnknownNameError


@pytest.fixture
def prior(network, normaliser):
    return DiffusionPrior(network, normaliser)


def test_only_its_own_hand_may_use_a_model(network, normaliser, config, shadow_hand, boxy_hand, tmp_path):
    save_model(tmp_path, config, network.state_dict(), normaliser)
    assert DiffusionPrior.from_folder(tmp_path, shadow_hand).config == config  # its joints are those of the toy
    with pytest.raises(
        CheckpointError, match=r"was trained for hand 'toy' .* but hand 'boxy' has joints one, two, .*`dexnudge train`"
    ):
        DiffusionPrior.from_folder(tmp_path, boxy_hand)


def test_guidance_scale_extrapolates_from_no_intent(prior, points):
    condition = prior.condition(points)
    x_t = prior.noise(6, generator=torch.Generator().manual_seed(0))
    with_intent = prior.predict_clean(x_t, 400, condition)
    without = prior.predict_clean(x_t, 400, condition.without_intent())
    assert torch.equal(prior.predict_clean(x_t, 400, condition, guidance_scale=0.0), without)
    found = prior.predict_clean(x_t, 400, condition, guidance_scale=2.5)
    torch.testing.assert_close(found, without + 2.5 * (with_intent - without))
    assert (with_intent - without).abs().max() > 1e-4


def test_nothing_to_extrapolate_without_intent(prior, points):
    nothing = prior.condition(points, "null", twist=None)
    assert nothing.behaviour.tolist() == [NULL_CLASS]
    x_t = prior.noise(6, generator=torch.Generator().manual_seed(0))
    estimate = prior.predict_clean(x_t, 400, nothing, guidance_scale=3.0)
    assert torch.equal(estimate, prior.predict_clean(x_t, 400, nothing))


def test_gradient_through_the_network_against_finite_differences(prior, points):
    condition = prior.condition(points)
    prior.network.double()
    condition = type(condition)(
        condition.object_feature.detach().double(),
        condition.behaviour,
        condition.twist.double(),
        condition.has_twist,
    )
    x_t = torch.randn(2, 25, generator=torch.Generator().manual_seed(0), dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: prior.predict_clean(x, 500, condition), (x_t,), eps=1e-6, atol=1e-6)


def test_conditions_per_sample(prior, points):
    several = torch.cat([points, 1.2 * points, 0.8 * points])
    x_t = prior.noise(3, generator=torch.Generator().manual_seed(0))
    together = prior.predict_clean(x_t, 100, prior.condition(several))
    for k in range(3):
        alone = prior.predict_clean(x_t[k : k + 1], 100, prior.condition(several[k : k + 1]))
        torch.testing.assert_close(together[k : k + 1], alone, atol=1e-5, rtol=1e-5)


def test_estimates_stay_within_the_limit(prior, points):
    limit = prior.config.architecture.clean_limit
    estimate = prior.predict_clean(1e4 * torch.ones(2, 25), 900, prior.condition(1e3 * points))
    assert estimate.abs().max() <= limit


def test_start_depends_on_the_generator_alone(prior):
    draws = [prior.noise(3, generator=torch.Generator().manual_seed(k)) for k in (0, 0, 1)]
    assert torch.equal(draws[0], draws[1])
    assert not torch.equal(draws[0], draws[2])


def test_unknown_class(prior, points):
    with pytest.raises(UnknownNameError, match="unknown behaviour class 'push'; expected one of grasp, non_prehensile"):
        prior.condition(points, "push")
