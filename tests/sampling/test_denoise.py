"""Coarse hands: as many as the scene needs, and the best of them."""

from dataclasses import replace

import pytest
import torch

from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.sampling import denoise as denoising
from dexnudge.sampling.denoise import DenoisingConfig, denoise
from dexnudge.sampling.guidance import unguided

NUM, FIRST, PARTICLES = 3, 4, 16
CONFIG = DenoisingConfig(particles=PARTICLES, first_particles=FIRST, coarse_steps=2)


class CountingPrior(DiffusionPrior):
    """Counts the hands that sampling starts from."""

    started = 0

    def noise(self, num, *, generator=None):
        self.started += num
        return super().noise(num, generator=generator)


@pytest.fixture
def counting(prior):
    return CountingPrior(prior.network, prior.normaliser)


@pytest.fixture
def run(hand, problem, counting):
    def drawn(config):
        return denoise(
            hand,
            problem,
            counting,
            num=NUM,
            rule=unguided,
            behaviour="non_prehensile",
            config=config,
            generator=torch.Generator().manual_seed(0),
        )

    return drawn


def test_a_draw_stops_looking_once_a_coarse_hand_is_good_enough(run, counting):
    run(replace(CONFIG, good_enough=torch.inf))
    assert counting.started == NUM * FIRST + NUM  # and the noise of the restart


def test_a_draw_to_which_nothing_is_good_enough_looks_at_all(run, counting):
    run(replace(CONFIG, good_enough=0.0))
    assert counting.started == NUM * PARTICLES + NUM


def test_only_draws_that_are_not_content_go_on(run, counting, monkeypatch):
    """Energies 1, 2, 3, ... in the order of looking, and 3 is good enough: the first draw stops, two go on."""
    seen = []

    def energy(_, x):
        value = torch.arange(len(x), dtype=torch.float32) + 1.0
        seen.append(len(x))
        return value if len(seen) == 1 else value + 100.0

    monkeypatch.setattr(denoising, "_scene_energy", energy)
    run(replace(CONFIG, good_enough=3.0))
    assert seen == [3 * 4, 2 * 4, 2 * 8]


def test_each_draw_keeps_its_own_best(hand, problem, counting, monkeypatch):
    """The chosen hand has the least energy of all that its draw has seen, by an energy computed here once more."""
    energies, hands = [], []
    real = denoising._scene_energy

    def watched(run, x):
        energies.append(real(run, x))
        hands.append(x)
        return energies[-1]

    monkeypatch.setattr(denoising, "_scene_energy", watched)
    condition = counting.condition(problem.cloud[None], "non_prehensile")
    generator = torch.Generator().manual_seed(0)
    run = denoising._Run(hand, problem, counting, condition, replace(CONFIG, good_enough=0.0), generator)
    chosen = denoising._best_coarse_hands(run, NUM)
    for draw in range(NUM):
        own = [
            (e.unflatten(0, (NUM, -1))[draw], x.unflatten(0, (NUM, -1))[draw])
            for e, x in zip(energies, hands, strict=True)
        ]
        energy, x = torch.cat([e for e, _ in own]), torch.cat([x for _, x in own])
        assert len(energy) == PARTICLES
        assert torch.equal(chosen[draw], x[energy.argmin()])
