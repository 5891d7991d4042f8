"""Terms of one's own in the sampler: the examples do what they promise, and nothing else changes."""

import importlib.util
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch

import dexnudge as dn
from dexnudge.energies.descent import pose_from_configuration
from dexnudge.sampling.methods import METHODS
from dexnudge.sampling.projection import NEGLIGIBLE_TERMS, STALLED_STEPS, Settling, project

EXAMPLES = Path(__file__).parents[2] / "examples"
NUM = 16


def example(name: str):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Pull:
    """Draws every fingertip to one place, however the object stands in the way [m^2]."""

    place: tuple[float, ...]
    name: str = "pull"
    weight: float = 1.0

    def __call__(self, hands, _):
        return (hands.hand.keypoints(hands.q) - torch.tensor(self.place)).square().sum(dim=(1, 2))


@dataclass(frozen=True)
class Broken:
    name: str = "broken"
    weight: float = 1.0

    def __call__(self, hands, _):
        return hands.q.sum(dim=1) * torch.nan


@pytest.fixture(scope="module")
def free(hand, scene):
    """Draws without terms, by the shipped prior."""
    return dn.Sampler(hand).sample(scene, num=NUM, seed=0)


def test_hands_keep_out_of_a_box_and_are_verified(hand, scene, free):
    """Half of the world beside the object, checked on dense points by other means than the term's."""
    x, y, z = scene.T_world_object[:3, 3]
    lower, upper = np.array([x - 0.5, y, z - 0.1]), np.array([x + 0.5, y + 0.5, z + 0.5])
    box = example("keep_out_box").KeepOutBox(tuple(lower.tolist()), tuple(upper.tolist()))
    kept = dn.Sampler(hand, terms=[box]).sample(scene, num=NUM, seed=0)

    def inside(samples):
        points = dn.HandBatch(hand, torch.as_tensor(samples.q), dense=True).points.numpy()
        return ((points > lower) & (points < upper)).all(axis=2).any(axis=1)

    assert inside(free).mean() > 0.8
    assert inside(kept).mean() < 0.1
    assert kept.success.mean() > 0.8
    report = kept.reports[0]
    assert report["terms_after"] < 0.1 * report["terms_before"] + NEGLIGIBLE_TERMS


def test_hands_stay_near_a_posture_and_are_verified(hand, scene, free):
    posture = (hand.lower + hand.upper) / 2
    near = example("preferred_posture").PreferredPosture(tuple(posture.tolist()))
    posed = dn.Sampler(hand, terms=[near]).sample(scene, num=NUM, seed=0)
    before, after = (np.abs(samples.q[:, 9:] - posture).mean() for samples in (free, posed))
    assert after < 0.6 * before
    assert posed.success.mean() > 0.8


@pytest.mark.parametrize("name", ["keep_out_box", "preferred_posture"])
def test_examples_run(name, capsys):
    example(name).main(num=2)
    without, with_term = capsys.readouterr().out.splitlines()
    assert without.startswith("0 terms: ")
    assert with_term.startswith("1 terms: ")


GUIDED = ("paper", "spherical", "steered_noise", "resampled", "clean_gradient", "clean_descent", "best_of_32")


@pytest.mark.parametrize("name", [*GUIDED, "random_start_projection"])
def test_every_rule_the_choice_of_coarse_hands_and_the_projection_lower_a_term(hand, scene, problem, prior, name):
    """Each without what follows it: guided draws are not projected."""
    place = (problem.T_world_canonical @ [0.0, 0.0, 0.2, 1.0])[:3]
    pull, method = Pull(tuple(place.tolist()), weight=10.0), METHODS[name]
    if name in GUIDED:
        brief = replace(method.denoising, num_inference_steps=10)
        method = replace(method, projection=None, denoising=brief)
    free, pulled = (
        dn.Sampler(hand, terms=terms, weights=prior).draw(problem, num=4, seed=0, method=method).q
        for terms in ((), (pull,))
    )
    before, after = (float(pull(dn.HandBatch(hand, torch.as_tensor(q)), scene).mean()) for q in (free, pulled))
    assert after < 0.98 * before


def test_penetration_comes_first(hand, problem, starts):
    """All fingertips are drawn into the middle of the phone, harder than penetration pushes them out."""
    pull = Pull(tuple(problem.scene.T_world_object[:3, 3].tolist()), weight=3.0)
    config = METHODS["steered_noise"].projection
    energy = problem.hand_energy(hand, len(starts), config.weights)
    energy.scene = problem.fields

    def clean(q):
        energy(pose_from_configuration(q))
        return (energy.depth.amax(dim=(1, 2)) < 0.0005).float().mean()

    plain, _ = project(hand, problem, starts, config=config)
    with_terms = replace(problem, terms=(pull,))
    q, report = project(hand, with_terms, starts, config=config)
    endless = replace(config, term_steps=config.max_steps, last_steps=0)
    never_ends, _ = project(hand, with_terms, starts, config=endless)
    assert clean(q) > 0.8 * clean(plain)
    assert clean(never_ends) < 0.5 * clean(q)
    assert (report["terms_after"] < report["terms_before"]).float().mean() > 0.9


def test_a_term_settles_when_it_is_negligible_or_falls_no_more():
    settling, rows = Settling(3), torch.arange(3)
    energy = torch.tensor([0.5 * NEGLIGIBLE_TERMS, 1.0, 1.0])
    for _ in range(STALLED_STEPS):
        assert settling(energy, rows).tolist() == [True, False, False]
        energy = energy * torch.tensor([1.0, 1.0, 0.9])
    assert settling(energy, rows).tolist() == [True, True, False]


@pytest.mark.parametrize("method", ["steered_noise", "random_start_projection", "paper", "coarse_hands"])
def test_a_broken_term_is_named(hand, problem, prior, method):
    sampler = dn.Sampler(hand, terms=[Broken()], weights=prior)
    with pytest.raises(dn.InputError, match="energy term 'broken' is NaN or infinite"):
        sampler.draw(problem, num=2, seed=0, method=method)


def test_terms_of_one_name_are_refused_by_the_sampler(hand):
    with pytest.raises(dn.InputError, match="two terms are named 'pull'"):
        dn.Sampler(hand, terms=[Pull((0.0, 0.0, 0.0)), Pull((1.0, 0.0, 0.0))])
