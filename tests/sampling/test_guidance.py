"""Guidance rules: their formulas, and what they do to hands that need no guidance."""

from dataclasses import replace
from itertools import pairwise

import pytest
import torch
from diffusers import DPMSolverMultistepScheduler

from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.diffusion.schedule import ddim_mean_and_sigma
from dexnudge.energies.descent import pose_from_configuration
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.force_residual import ForceResidual
from dexnudge.energies.terms import TermWeights
from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.sampling.denoise import DenoisingConfig
from dexnudge.sampling.guidance import (
    ReverseStep,
    active_contacts,
    configuration_energy,
    gradient_at_clean_estimate,
    gradient_through_network,
    squared_violation,
    unguided,
    unit,
)
from dexnudge.sampling.guidance_rules import (
    CleanDescent,
    CleanGradient,
    CleanSpherical,
    PaperGuidance,
    Resampled,
    SphericalGuidance,
    resampled,
)
from force_balance import solve

BATCH = 6
WEIGHTS = DenoisingConfig().weights


class Knowing(DiffusionPrior):
    """A prior that knows the clean hands: its estimate is always they."""

    def __init__(self, prior: DiffusionPrior, clean: torch.Tensor) -> None:
        super().__init__(prior.network, prior.normaliser)
        self.clean = clean

    def predict_clean(self, *_, **__):
        return self.normaliser.normalise(self.clean)


@pytest.fixture
def make_step(hand, problem, prior):
    """Makes a step from t to t_previous of a batch of noise, or of `x_t`."""

    def make(*, t: int = 400, t_previous: int = 350, use: DiffusionPrior = prior, x_t=None, batch: int = BATCH):
        noise = use.noise(batch, generator=torch.Generator().manual_seed(0)) if x_t is None else x_t
        return ReverseStep(
            prior=use,
            condition=use.condition(problem.cloud[None]),
            hand=hand,
            energy=HandEnergy(hand, problem.guiding_fields, len(noise), WEIGHTS),
            x_t=noise,
            t=t,
            t_previous=t_previous,
            guidance_scale=1.0,
            eta=0.0,
            generator=torch.Generator().manual_seed(1),
        )

    return make


@pytest.mark.parametrize("strength", [0.05, 0.5])
def test_the_papers_rule_moves_every_sample_by_its_strength(make_step, strength):
    guided, plain = PaperGuidance(strength=strength)(make_step()), unguided(make_step())
    torch.testing.assert_close((guided - plain).norm(dim=1), torch.full((BATCH,), strength), rtol=1e-3, atol=1e-6)


def test_the_papers_rule_moves_against_the_gradient(make_step, prior):
    """A small step to where the rule points lowers the energy of the clean estimate."""
    step = make_step()
    direction = PaperGuidance(strength=1.0)(step) - unguided(step)

    def energy_at(x):
        clean = prior.predict_clean(x, step.t, step.condition)
        return configuration_energy(prior.normaliser.denormalise(clean), step.energy)

    with torch.no_grad():
        before, after = energy_at(step.x_t).clone(), energy_at(step.x_t + 1e-3 * direction)
    assert ((after - before) < 0).all()


@pytest.mark.parametrize("rule", [PaperGuidance(), CleanGradient()], ids=["paper", "clean gradient"])
def test_samples_are_guided_one_by_one(make_step, rule):
    together = rule(make_step())
    alone = rule(make_step(x_t=make_step().x_t[2:3]))
    torch.testing.assert_close(alone[0], together[2], atol=1e-4, rtol=0)


def everywhere_alike(rate: float = 0.8) -> CleanSpherical:
    """Ours with one rate for all samples and coordinates."""
    return CleanSpherical(rate=rate, joints=1.0, negligible=0.0)


SPHERICAL = pytest.mark.parametrize("rule", [SphericalGuidance, everywhere_alike])


def sphere(step, rule) -> tuple[torch.Tensor, torch.Tensor, float]:
    """(gradient, mean, radius) of a spherical rule, from its formula."""
    if rule is SphericalGuidance:
        x0_hat, gradient = gradient_through_network(step)
    else:
        x0_hat = step.prior.predict_clean(step.x_t, step.t, step.condition)
        _, gradient = gradient_at_clean_estimate(step, x0_hat)
    mean, sigma = ddim_mean_and_sigma(step.prior.schedule, step.x_t, x0_hat, step.t, step.t_previous, eta=1.0)
    return gradient, mean, mean.shape[1] ** 0.5 * sigma


@SPHERICAL
@pytest.mark.parametrize("rate", [0.0, 0.2, 1.0])
def test_spherical_guidance_stays_on_the_sphere(make_step, rule, rate):
    _, mean, radius = sphere(make_step(), rule)
    moved = rule(rate=rate)(make_step()) - mean
    assert radius > 0.1
    torch.testing.assert_close(moved.norm(dim=1), torch.full((BATCH,), radius), rtol=1e-4, atol=1e-5)


@SPHERICAL
def test_spherical_guidance_goes_from_the_noise_to_steepest_descent(make_step, rule):
    gradient, mean, _ = sphere(make_step(), rule)
    noise = torch.randn(mean.shape, generator=torch.Generator().manual_seed(1))
    cosine = {
        rate: [torch.cosine_similarity(rule(rate=rate)(make_step()) - mean, to) for to in (noise, -gradient)]
        for rate in (0.0, 0.5, 1.0)
    }
    torch.testing.assert_close(cosine[0.0][0], torch.ones(BATCH), atol=1e-4, rtol=0)
    torch.testing.assert_close(cosine[1.0][1], torch.ones(BATCH), atol=1e-4, rtol=0)
    assert (cosine[0.5][1] > cosine[0.0][1]).all()


@SPHERICAL
def test_spherical_guidance_ends_at_the_clean_estimate(make_step, rule):
    """No noise is left in the last step, and the sphere is a point."""
    step = make_step(t=20, t_previous=-1)
    _, mean, radius = sphere(step, rule)
    assert radius == 0.0
    torch.testing.assert_close(rule()(make_step(t=20, t_previous=-1)), mean)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # of diffusers
def test_ours_takes_the_mean_of_the_second_order_solver(make_step, prior, starts):
    """Against diffusers' SDE-DPM-Solver++(2M), where nothing is steered and the noise is taken off."""
    alphas = prior.schedule.alphas_cumprod
    betas = torch.cat([1.0 - alphas[:1], 1.0 - alphas[1:] / alphas[:-1]])
    theirs = DPMSolverMultistepScheduler(
        trained_betas=betas.tolist(), algorithm_type="sde-dpmsolver++", prediction_type="sample", euler_at_final=True
    )
    timesteps = [700, 600, 450, 300]
    theirs.set_timesteps(timesteps=timesteps)
    rule, x = CleanSpherical(rate=0.0), prior.noise(BATCH, generator=torch.Generator().manual_seed(0))
    noise = torch.randn(x.shape, generator=torch.Generator().manual_seed(1))
    for place, (t, t_previous) in enumerate(pairwise([*timesteps, -1])):
        use = Knowing(prior, starts[place : place + BATCH])
        step = make_step(t=t, t_previous=t_previous, use=use, x_t=x)
        _, sigma = ddim_mean_and_sigma(prior.schedule, x, x, t, t_previous, eta=1.0)
        ours = rule(step) - x.shape[1] ** 0.5 * sigma * unit(noise)
        x = theirs.step(use.predict_clean(), t, x, variance_noise=torch.zeros_like(x)).prev_sample
        torch.testing.assert_close(ours, x, atol=1e-4, rtol=1e-4)


def test_ours_does_not_steer_before_the_estimate_means_something(make_step):
    steered, plain = (CleanSpherical(rate=rate)(make_step(t=980, t_previous=900)) for rate in (1.0, 0.0))
    assert make_step(t=980).alpha_bar < CleanSpherical().begin < make_step().alpha_bar
    torch.testing.assert_close(steered, plain)


def test_ours_steers_joints_less_and_hands_that_are_almost_right_less():
    rule, energy = CleanSpherical(rate=0.8, joints=0.5, negligible=1e-3), torch.tensor([0.0, 1e-3, 1.0])
    rates = rule.rates(energy, ROOT_COORDINATES + 4)
    expected = torch.tensor([0.0, 0.4, 0.8 / 1.001])
    torch.testing.assert_close(rates[:, :ROOT_COORDINATES], expected[:, None].expand(3, ROOT_COORDINATES))
    torch.testing.assert_close(rates[:, ROOT_COORDINATES:], 0.5 * expected[:, None].expand(3, 4))


def test_joint_angles_keep_more_of_their_noise(make_step):
    _, mean, _ = sphere(make_step(), CleanSpherical)
    noise = torch.randn(mean.shape, generator=torch.Generator().manual_seed(1))
    joints = slice(ROOT_COORDINATES, None)
    kept = {
        share: torch.cosine_similarity(
            (CleanSpherical(rate=1.0, joints=share, negligible=0.0)(make_step()) - mean)[:, joints], noise[:, joints]
        )
        for share in (0.0, 0.5, 1.0)
    }
    assert (kept[0.0] > kept[0.5]).all()
    assert (kept[0.5] > kept[1.0]).all()
    torch.testing.assert_close(kept[0.0], torch.ones(BATCH), atol=1e-4, rtol=0)


def test_draws_go_on_as_often_as_their_weights_say():
    energy = 0.01 * torch.log(torch.tensor([8.0, 8.0, 8.0, 8.0, 4.0, 1.0, 1e9, 1e9]))  # weights 1, 1, 1, 1, 2, 8, 0, 0
    chosen = resampled(energy, temperature=0.01, generator=torch.Generator().manual_seed(0))
    counts = torch.bincount(chosen, minlength=8)
    expected = 8 * torch.tensor([1.0, 1.0, 1.0, 1.0, 2.0, 8.0, 0.0, 0.0]) / 14
    assert ((counts - expected).abs() < 1).all()  # what systematic resampling promises
    even = resampled(torch.full((8,), 0.3), temperature=0.01, generator=torch.Generator())
    torch.testing.assert_close(even, torch.arange(8))


def test_resampling_replaces_hands_that_are_in_the_way(make_step, prior, starts):
    """Four of the clean hands stand in the table; the others take their places."""
    clean = starts[:BATCH].clone()
    clean[:4, 2] -= 0.3
    rule, step = Resampled(every=2), replace(make_step(use=Knowing(prior, clean)), t_previous=-1)
    first = prior.normaliser.denormalise(rule(step))
    torch.testing.assert_close(first, clean, rtol=0, atol=1e-4)
    second = prior.normaliser.denormalise(rule(step))
    for hand in second:
        assert (hand - clean[4:]).abs().amax(dim=1).min() < 1e-4


def test_against_the_gradient_at_the_clean_estimate_the_energy_falls(make_step, prior):
    step = make_step()
    x0_hat = prior.predict_clean(step.x_t, step.t, step.condition)
    _, gradient = gradient_at_clean_estimate(step, x0_hat)
    with torch.no_grad():
        before = configuration_energy(prior.normaliser.denormalise(x0_hat), step.energy).clone()
        after = configuration_energy(prior.normaliser.denormalise(x0_hat - 1e-3 * unit(gradient)), step.energy)
    assert (after < before).all()


def test_the_clean_gradient_moves_the_estimate_by_its_strength_downhill(make_step, prior, hand, starts):
    knowing, rule = Knowing(prior, hand.clamp(starts[:BATCH])), CleanGradient(strength=0.01)
    step = make_step(use=knowing, t=20, t_previous=-1)
    moved = rule(step) - prior.normaliser.normalise(knowing.clean)
    torch.testing.assert_close(moved.norm(dim=1), torch.full((BATCH,), 0.01), rtol=1e-3, atol=1e-6)
    before = configuration_energy(knowing.clean, step.energy).clone()
    after = configuration_energy(
        prior.normaliser.denormalise(prior.normaliser.normalise(knowing.clean) + 0.1 * moved), step.energy
    )
    assert ((after - before) < 0).all()


def test_energy_of_configurations_is_differentiated_right(hand, problem, starts):
    """Against finite differences in q, the six rotation entries free; targets make the energy smooth."""
    only_targets = TermWeights(environment=0.0, object=0.0, self=0.0, contact=0.0, target=1.0)
    energy = HandEnergy(hand, problem.fields, 3, only_targets)
    tips = hand.fingertip_indices
    energy.target[:, tips], energy.target_weight[:, tips] = 0.02, 1.0
    generator = torch.Generator().manual_seed(2)
    q = starts[:3] + 0.05 * torch.randn(starts[:3].shape, generator=generator)
    q.requires_grad_()
    upstream = torch.tensor([1.0, -2.0, 0.5])
    (gradient,) = torch.autograd.grad((upstream * configuration_energy(q, energy)).sum(), q)
    step, slopes = 2e-3, torch.zeros_like(gradient)
    with torch.no_grad():
        for column in range(q.shape[1]):
            shift = step * torch.nn.functional.one_hot(torch.tensor(column), q.shape[1])
            above = configuration_energy(q + shift, energy).clone()
            slopes[:, column] = upstream * (above - configuration_energy(q - shift, energy)) / (2 * step)
    assert float(slopes.abs().max()) > 0.05
    torch.testing.assert_close(gradient, slopes, atol=2e-3 * float(slopes.abs().max()), rtol=0.01)


def test_limits_and_couplings_pull_joint_angles_back(hand, problem, starts):
    """Nothing but the limits: the energy is their squared violation, its gradient that of a plain formula."""
    off = dict.fromkeys(("environment", "object", "self", "contact"), 0.0)
    energy = HandEnergy(hand, problem.fields, 3, TermWeights(**off, limits=2.0))
    q = hand.clamp(starts[:3]).clone()
    torch.testing.assert_close(configuration_energy(q, energy), torch.zeros(3))
    follower, leader = (int(index) + 9 for index in hand.coupled_indices[0])
    q[0, 9] = float(hand.upper[0]) + 0.1
    q[1, 9] = float(hand.lower[0]) - 0.2
    q[2, leader], q[2, follower] = 0.5, 0.8
    q.requires_grad_()
    value = configuration_energy(q, energy)
    torch.testing.assert_close(value, 2.0 * torch.tensor([0.01, 0.04, 0.09]), rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(squared_violation(hand, q[:, 9:]), value / 2)
    (gradient,) = torch.autograd.grad(value.sum(), q)
    expected = torch.zeros_like(q)
    expected[0, 9], expected[1, 9], expected[2, follower], expected[2, leader] = 0.4, -0.8, 1.2, -1.2
    torch.testing.assert_close(gradient, expected, rtol=1e-4, atol=1e-5)


def balanced_step(make_step, hand, problem, use, weight: float) -> ReverseStep:
    weights = replace(WEIGHTS, force=weight)
    energy = HandEnergy(hand, problem.guiding_fields, BATCH, weights, balances=problem.balances)
    return replace(make_step(use=use, t=20, t_previous=-1), energy=energy)


def test_the_force_balance_guides_contacts_by_its_own_gradient(make_step, hand, problem, prior, starts):
    clean = hand.clamp(starts[:BATCH])
    step = balanced_step(make_step, hand, problem, Knowing(prior, clean), weight=0.002)
    step.set_active_contacts(clean)
    tips = hand.fingertip_indices
    torch.testing.assert_close(step.energy.extra_force[:, tips], 0.002 * step.energy.force.gradient)
    torch.testing.assert_close(step.pull_to_balance(), 0.001 * step.energy.force.residual.square())
    assert make_step().pull_to_balance() == 0.0


def test_descent_with_the_force_balance_ends_nearer_to_it(make_step, hand, problem, prior, starts):
    """The same estimates guided with and without the term; the residual is then solved anew, from a cold start."""
    tips = hand.fingertip_indices
    left = {}
    for weight in (0.0, 0.05):
        rule, clean = CleanDescent(), hand.clamp(starts[:BATCH])
        for _ in range(6):
            step = balanced_step(make_step, hand, problem, Knowing(prior, clean), weight)
            clean = hand.clamp(prior.normaliser.denormalise(rule(step)))
        step.energy.contact_weight[:, tips] = 1.0
        step.energy(pose_from_configuration(clean))
        judge = ForceResidual(problem.balances, torch.ones(BATCH, dtype=torch.int32), len(tips))
        points, normals = (getattr(step.energy, f"contact_{name}")[:, tips] for name in ("point", "normal"))
        solve(judge, points, normals, sweeps=300)
        left[weight] = float(judge.residual.mean())
    assert left[0.05] < left[0.0]


def test_unguided_is_the_plain_step(make_step, prior):
    step = make_step()
    clean = prior.predict_clean(step.x_t, step.t, step.condition)
    here, there = (float(prior.schedule.alphas_cumprod[t]) for t in (step.t, step.t_previous))
    noise = (step.x_t - here**0.5 * clean) / (1 - here) ** 0.5
    torch.testing.assert_close(unguided(step), there**0.5 * clean + (1 - there) ** 0.5 * noise, atol=1e-4, rtol=1e-4)


def test_before_it_begins_descent_is_the_plain_step(make_step, prior):
    noisy = [t for t in range(1000) if prior.schedule.alphas_cumprod[t] < CleanDescent().begin]
    step = make_step(t=noisy[0], t_previous=noisy[0] - 50)
    torch.testing.assert_close(CleanDescent()(step), unguided(step))


def test_descent_lowers_the_energy_of_the_clean_estimate(make_step, prior, hand, starts):
    """Its state lives on: step by step towards clean data, on estimates that penetrate."""
    clean, rule = hand.clamp(starts[:BATCH]), CleanDescent()
    first = make_step(use=Knowing(prior, clean))
    first.energy.contact_weight[:, hand.fingertip_indices] = 0.0
    before = first.energy(pose_from_configuration(clean)).clone()
    for t in (300, 200, 100, 20):
        x = rule(make_step(use=Knowing(prior, clean), t=t, t_previous=-1, x_t=prior.normaliser.normalise(clean)))
        clean = hand.clamp(prior.normaliser.denormalise(x))
    after = first.energy(pose_from_configuration(clean))
    assert float(after.mean()) < 0.5 * float(before.mean())


def test_steps_shrink_where_the_energy_is_negligible(make_step, prior, hand, starts):
    clean = hand.equalise_tendon_joints(starts[:BATCH])  # as descent does
    travelled = []
    for rule in (CleanDescent(negligible=1.0e9), CleanDescent(negligible=1.0e-12)):
        x = rule(make_step(use=Knowing(prior, clean), t=20, t_previous=-1))
        travelled.append(
            (hand.keypoints(prior.normaliser.denormalise(x)) - hand.keypoints(clean)).norm(dim=2).mean(dim=1)
        )
    assert float(travelled[0].max()) < 1.0e-4
    assert float(travelled[1].min()) > 1.0e-3


def test_descent_ends_within_limits(make_step, prior, hand, starts):
    knowing = Knowing(prior, hand.clamp(starts[:BATCH]))
    x = CleanDescent()(make_step(use=knowing, t=20, t_previous=-1))
    q = prior.normaliser.denormalise(x)
    torch.testing.assert_close(hand.clamp(q), q, atol=1e-5, rtol=0)


def test_fingertips_near_the_object_are_held_and_always_the_nearest():
    distance = torch.tensor([[0.001, 0.02, 0.009, 0.5], [0.3, 0.2, 0.1, 0.4]])
    expected = torch.tensor([[1.0, 0.0, 1.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    assert torch.equal(active_contacts(distance, reach=0.010), expected)
