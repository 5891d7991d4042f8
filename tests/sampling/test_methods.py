"""Methods with other weights: both stages take them, and a method tells what it uses."""

import pytest
import torch

from dexnudge.errors import InputError
from dexnudge.sampling.denoise import denoise
from dexnudge.sampling.methods import METHODS, find_method


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
