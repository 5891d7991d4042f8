"""Methods with other weights: both stages take them, and a method tells what it uses."""

import sys

import numpy as np
import pytest
import torch

from dexnudge.errors import InputError, UnknownNameError
from dexnudge.sampling.denoise import denoise
from dexnudge.sampling.methods import METHODS, find_method
from dexnudge.sampling.sampler import Sampler


def test_weights_reach_guidance_and_projection_and_nothing_else():
    ours = find_method("steered_noise")
    changed = ours.with_weights({"sweep": 0.0, "clearance_base": 0.03})
    assert changed.weights().keys() == {"guidance", "projection"}
    for stage, before in ours.weights().items():
        after = changed.weights()[stage]
        assert (after["sweep"], after["clearance_base"]) == (0.0, 0.03)
        assert {name: value for name, value in after.items() if before[name] != value}.keys() <= {
            "sweep",
            "clearance_base",
        }
    assert ours.with_weights({}) == ours
    assert changed.denoising.particles == ours.denoising.particles


def test_a_method_names_only_the_stages_that_it_has():
    stages = {name: set(method.weights()) for name, method in METHODS.items()}
    assert stages["guidance_only"] == {"guidance"}
    assert stages["random_start_projection"] == {"projection"}
    assert find_method("guidance_only").with_weights({"force": 1.0}).projection is None


@pytest.mark.parametrize("value", [-0.1, float("nan")])
def test_weights_that_make_no_sense(value):
    with pytest.raises(InputError, match="the weight 'sweep' of the energy is"):
        find_method("steered_noise").with_weights({"sweep": value})


def test_all_methods_share_the_losses():
    energies = [method.weights() for method in METHODS.values()]
    for stage in ("guidance", "projection"):
        used = [energy[stage] for energy in energies if stage in energy]
        assert all(weights == used[0] for weights in used)


def test_the_force_balance_guides_where_it_has_a_weight(hand, problem, prior):
    def drawn(weight):
        method = find_method("steered_noise").with_weights({"force": weight})
        return denoise(
            hand,
            problem,
            prior,
            num=2,
            rule=method.make_rule(),
            behaviour=method.behaviour,
            config=method.denoising,
            generator=torch.Generator().manual_seed(0),
        )

    assert torch.equal(drawn(0.0), drawn(0.0))
    assert not torch.allclose(drawn(0.0), drawn(0.1))


PACKAGE = """
import torch
from dataclasses import replace
from dexnudge.sampling.methods import METHODS

class HalfSteps:
    "Goes half of the way."
    def __call__(self, step):
        x0_hat = step.clean_estimate()
        return 0.5 * (step.ddim(x0_hat) + step.x_t)

class Short:
    def __call__(self, step):
        return step.x_t[:, 1:]

class Lost:
    def __call__(self, step):
        return step.x_t * torch.nan

whole = replace(METHODS["unguided"], summary="a whole method")
number = 3
"""


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A package on the path that brings rules, a method, and what is neither."""
    (tmp_path / "own_rules.py").write_text(PACKAGE)
    info = tmp_path / "own_rules-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own-rules\nVersion: 1.0\n")
    places = {"half": "HalfSteps", "short": "Short", "lost": "Lost", "whole": "whole", "number": "number"}
    lines = [f"{name} = own_rules:{place}" for name, place in {**places, "paper": "HalfSteps"}.items()]
    (info / "entry_points.txt").write_text("\n".join(["[dexnudge.guidance_rules]", *lines]))
    monkeypatch.syspath_prepend(tmp_path)
    yield
    sys.modules.pop("own_rules", None)


@pytest.mark.usefixtures("installed")
def test_a_package_brings_a_rule_or_a_method(hand, problem, prior):
    method, whole = find_method("half"), find_method("whole")
    assert method.summary == "Goes half of the way."
    assert method.projection == METHODS["steered_noise"].projection
    assert (whole.summary, whole.projection) == ("a whole method", None)
    assert find_method("paper") is METHODS["paper"], "a built-in name stays what it is"
    q = Sampler(hand, weights=prior).draw(problem, num=2, seed=0, method="half").q
    assert np.isfinite(q).all()


@pytest.mark.usefixtures("installed")
def test_what_a_package_brings_is_named_where_it_is_of_no_use(hand, problem, prior):
    sampler = Sampler(hand, weights=prior)
    for name, message in (
        ("short", r"guidance rule 'short' returned \(2, 24\)"),
        ("lost", "guidance rule 'lost' .*NaN"),
    ):
        with pytest.raises(InputError, match=message):
            sampler.draw(problem, num=2, seed=0, method=name)
    with pytest.raises(InputError, match=r"guidance rule 'number' of package own-rules .*is of type int"):
        find_method("number")
    with pytest.raises(
        UnknownNameError, match=r"did you mean 'half'.*nearest_pose, half, lost, number, paper, short, whole"
    ):
        find_method("halve")
