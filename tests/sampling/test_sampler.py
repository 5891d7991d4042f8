"""The sampler as its users see it: errors, seeds, and a whole draw without a model."""

import re

import numpy as np
import pytest
import torch

from dexnudge.errors import CheckpointError, InputError, UnknownNameError
from dexnudge.sampling.denoise import inference_timesteps
from dexnudge.sampling.methods import METHODS
from dexnudge.sampling.sampler import Sampler, load_sampler
from dexnudge.verification.verdicts import verify

RANDOM = "random_start_projection"
NAMES = (
    "ours, resampled, coarse_hands, clean_descent, guidance_only, paper, paper_guidance_only, spherical, clean_gradient, "
    "best_of_32, unguided, unguided_projection, grasp_projection, random_start_projection, nearest_pose"
)


@pytest.fixture(scope="module")
def sampler(hand, prior):
    return Sampler(hand, prior)


@pytest.fixture(scope="module")
def drawn(sampler, scene):
    return sampler.sample(scene, num=16, seed=3, method=RANDOM)


def test_unknown_method(sampler, scene):
    with pytest.raises(UnknownNameError) as caught:
        sampler.sample(scene, num=1, method="magic")
    assert str(caught.value) == f"unknown method 'magic'; expected one of {NAMES}"


def test_nothing_to_draw(sampler, scene):
    with pytest.raises(InputError) as caught:
        sampler.sample(scene, num=0)
    assert str(caught.value) == "cannot draw 0 configurations; expected at least 1; mend --num"


def test_missing_weights(hand, tmp_path):
    folder = tmp_path / "nowhere"
    with pytest.raises(CheckpointError) as caught:
        Sampler.from_pretrained(hand, weights=folder)
    assert str(caught.value) == (
        f"no weights for hand 'shadow_lite': expected a model folder, got {folder}, which does not exist; "
        "train some with `dexnudge train` and pass them with --weights"
    )


def test_a_method_that_needs_the_prior_says_so(hand, scene):
    with pytest.raises(CheckpointError, match=re.escape("this sampler has no prior; expected weights")):
        Sampler(hand, None).sample(scene, num=1, method="steered_noise")


def test_weights_are_loaded_only_where_a_method_needs_them(hand, tmp_path):
    assert load_sampler(hand, [RANDOM], weights=tmp_path / "nowhere").prior is None
    with pytest.raises(CheckpointError):
        load_sampler(hand, [RANDOM, "steered_noise"], weights=tmp_path / "nowhere")
    with pytest.raises(UnknownNameError):
        load_sampler(hand, ["magic"])


def test_a_random_start_is_projected_to_configurations_that_succeed(hand, scene, drawn):
    assert drawn.q.shape == (16, 9 + hand.num_joints)
    assert drawn.q.dtype == np.float32
    verdicts = verify(hand, scene, drawn.q.astype(np.float64))
    assert verdicts.success.any()
    assert not np.isnan(verdicts.penetration_object).any()
    assert set(drawn.timings) == {"prepare", "draw", "project"}
    assert all(seconds >= 0 for seconds in drawn.timings.values())
    assert 0 < drawn.report["projection_converged"] <= 1


def test_the_order_is_the_samplers_own_measure(hand, scene, drawn):
    """Converged ones stand first, and more of the first half succeed."""
    success = verify(hand, scene, drawn.q.astype(np.float64)).success
    assert success[:8].sum() >= success[8:].sum()


def test_the_same_seed_gives_the_same_draws_and_another_others(sampler, scene, drawn):
    again = sampler.sample(scene, num=16, seed=3, method=RANDOM)
    np.testing.assert_array_equal(again.q, drawn.q)
    assert again.report == drawn.report
    assert not np.array_equal(sampler.sample(scene, num=16, seed=4, method=RANDOM).q, drawn.q)


@pytest.mark.parametrize("method", [name for name in METHODS if METHODS[name].start == "prior"])
def test_every_method_with_a_prior_draws_legal_rotations(sampler, problem, hand, method):
    result = sampler.draw(problem, num=2, seed=0, method=METHODS[method])
    again = sampler.draw(problem, num=2, seed=0, method=METHODS[method])
    assert result.q.shape == (2, 9 + hand.num_joints)
    assert np.isfinite(result.q).all()
    columns = result.q[:, 3:9].reshape(-1, 2, 3)
    np.testing.assert_allclose(columns @ columns.swapaxes(1, 2), np.tile(np.eye(2), (2, 1, 1)), atol=1e-4)
    np.testing.assert_array_equal(again.q, result.q)
    assert bool(result.report) == (METHODS[method].projection is not None)


def test_the_world_and_the_canonical_frame_agree(hand, problem, starts):
    """Fingertips of a configuration in the world are those in frame C, carried over."""
    world = torch.as_tensor(problem.to_world(starts))
    T = torch.as_tensor(problem.T_world_canonical, dtype=torch.float32)
    carried = hand.keypoints(starts) @ T[:3, :3].T + T[:3, 3]
    torch.testing.assert_close(hand.keypoints(world), carried, atol=1e-5, rtol=0)


@pytest.mark.parametrize(("train", "steps"), [(1000, 20), (1000, 7), (50, 50), (1000, 1)])
def test_timesteps_begin_with_the_noisiest_and_fall_evenly(train, steps):
    found = inference_timesteps(train, steps)
    assert (len(found), found[0]) == (steps, train - 1)
    assert found[-1] >= 0
    gaps = -np.diff(found)
    assert (np.abs(gaps - train / steps) <= 1).all()
