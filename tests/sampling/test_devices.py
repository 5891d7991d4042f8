"""Every stage of sampling on a device that is not the CPU: nothing lies elsewhere, and the draws are those of the CPU."""

import copy
import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from torch.nn.attention import SDPBackend, sdpa_kernel

import dexnudge as dn
from dexnudge.dataset.schema import NUM_DIRECTIONS
from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.errors import CheckpointError, InputError
from dexnudge.planning.reach_term import ReachTerm
from dexnudge.sampling import sampler as sampler_module
from dexnudge.sampling.methods import METHODS, find_method
from dexnudge.sampling.starts import TrainingPoses
from dexnudge.verification import verdicts

from .second_device import second_device

pytestmark = pytest.mark.slow

NUM = 2


@dataclass(frozen=True)
class Pull:
    """Draws the links of a hand to one place [m^2]."""

    name: str = "pull"
    weight: float = 1.0e-5

    def __call__(self, hands, scene):
        place = torch.as_tensor(scene.T_world_object[:3, 3], dtype=hands.q.dtype, device=hands.q.device)
        return (hands.T_world_link[:, :, :3, 3] - place).square().sum(dim=(1, 2))


@dataclass(frozen=True)
class Height:
    """No point of the hand is below the ground [m]."""

    name: str = "height"

    def __call__(self, hands, _):
        least = hands.points[:, :, 2].amin(dim=1)
        return dn.CriterionResult(least, least > 0.0, "too low")


@pytest.fixture
def second(monkeypatch):
    for module in (sampler_module, verdicts):
        monkeypatch.setattr(module, "check_device", lambda name: name)
    monkeypatch.setattr(sampler_module, "free_memory", lambda _: math.inf)
    with second_device() as name:
        yield name


def check(hand, prior, scene, second, *, terms=(), poses=None, **options):
    """Draws and verdicts there are those of the CPU by the same seed, bit by bit: the second device computes as it does."""
    moved = DiffusionPrior(copy.deepcopy(prior.network).to(second), prior.normaliser.to(second))
    with sdpa_kernel(SDPBackend.MATH):  # the one kernel of attention that both have
        here, there = (
            dn.Sampler(hand, weights=weights, device=device, terms=terms, poses=poses).sample(scene, num=NUM, **options)
            for weights, device in ((prior, "cpu"), (moved, second))
        )
    np.testing.assert_array_equal(there.q, here.q)
    for name, value in here.verdicts.values.items():
        np.testing.assert_array_equal(there.verdicts.values[name], value)


SHORT = {"max_steps": 8, "turning_factor": 1, "idle_steps": 6, "guided_steps": 3, "term_steps": 4}


def short(name: str):
    """A method whose loops run a few times, each branch at least once."""
    method = find_method(name)
    steps = min(method.denoising.num_inference_steps, 5)
    projection = method.projection and replace(method.projection, **SHORT)
    return replace(method, denoising=replace(method.denoising, num_inference_steps=steps), projection=projection)


@pytest.mark.parametrize("name", [name for name, method in METHODS.items() if method.start != "nearest"])
def test_a_method_draws_projects_and_verifies_there(hand, prior, scene, second, name):
    check(hand, prior, scene, second, method=short(name), criteria=[*dn.default_criteria(), Height()])


def test_stored_poses_start_there(hand, prior, scene, second, starts):
    feasible = np.ones((len(starts), NUM_DIRECTIONS), dtype=bool)
    clouds = torch.rand(1, 64, 3, generator=torch.Generator(device="cpu").manual_seed(0), device="cpu")
    poses = TrainingPoses(starts, np.zeros(len(starts), dtype=np.int64), feasible, 0.1 * clouds)
    check(hand, prior, scene, second, method=short("nearest_pose"), poses=poses)


@pytest.mark.parametrize(("family", "options"), [("table", {"turn_deg": 60.0}), ("book", {})])
def test_a_turn_under_uncertainty_with_own_terms(hand, prior, second, crane, family, options):
    scene = dn.build_scene(family, "phone", seed=0, **options)
    uncertain = dn.Uncertainty(friction=(0.5, 1.0), mass=(0.5, 2.0), pose_mm=2.0, worlds=2)
    check(hand, prior, scene, second, terms=[Pull()], method=short("steered_noise"), uncertain=uncertain)


def test_the_reach_of_an_arm_is_a_term_there(hand, prior, scene, second, crane):
    check(hand, prior, scene, second, terms=[ReachTerm(crane)], method=short("steered_noise"))


def test_what_lies_on_another_device_is_refused(hand, prior, problem, second):
    sampler = dn.Sampler(hand, weights=prior, device=second)
    with pytest.raises(InputError, match="`problem` was prepared on cpu; expected meta"):
        sampler.draw(problem, num=1, seed=0)
    with pytest.raises(CheckpointError, match="the prior that `weights` holds lies on cpu; expected meta"):
        _ = sampler.prior


def test_the_rules_of_two_devices(second):
    """The reference itself: what CUDA refuses, it refuses; what it allows, it computes."""
    there, here = torch.arange(6, device="cpu").float().reshape(2, 3).to(second), torch.ones(2, 3, device="cpu")
    assert (there[:, [0, 2]] * 2).cpu().tolist() == [[0.0, 4.0], [6.0, 10.0]]
    assert there[torch.tensor([1], device="cpu")].tolist() == [[3.0, 4.0, 5.0]]
    for refused in (lambda: there + here, lambda: here[there[0].long()], lambda: torch.cat([here, there])):
        with pytest.raises(AssertionError, match="two devices"):
            refused()
    with pytest.raises(AssertionError, match="generator of cpu"):
        torch.randn(2, generator=torch.Generator(device="cpu"), device=second)
    with pytest.raises(RuntimeError, match="numpy"):
        there.numpy()
