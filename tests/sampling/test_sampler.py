"""The sampler as its users see it: errors, seeds, and a whole draw without a model."""

import shutil
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from trimesh.transformations import translation_matrix

from dexnudge.diffusion.checkpoint import SHIPPED_WEIGHTS
from dexnudge.errors import CheckpointError, InputError, UnknownNameError
from dexnudge.hands.export import export_hand
from dexnudge.hands.registry import load_hand
from dexnudge.results.samples import Sample, Samples
from dexnudge.sampling import sampler as sampler_module
from dexnudge.sampling.methods import METHODS
from dexnudge.sampling.sampler import MEMORY_PER_HAND, MEMORY_SHARE, Sampler, call_seed
from dexnudge.verification.verdicts import verify

RANDOM = "random_start_projection"
NAMES = (
    "steered_noise, resampled, coarse_hands, clean_descent, guidance_only, paper, paper_guidance_only, spherical, "
    "clean_gradient, best_of_32, unguided, unguided_projection, grasp_projection, random_start_projection, nearest_pose"
)


@pytest.fixture(scope="module")
def sampler(hand, prior):
    return Sampler(hand, weights=prior)


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
    assert str(caught.value) == "`num` is 0; expected at least 1"


def test_missing_weights(hand, tmp_path):
    folder = tmp_path / "nowhere"
    with pytest.raises(CheckpointError) as caught:
        Sampler.from_pretrained(hand, weights=folder)
    assert str(caught.value) == (
        f"no weights for hand 'shadow_lite': expected a model folder, got {folder}, which does not exist; learn some with "
        "`dexnudge hand HAND --learn`, pass a model folder as `weights`, or draw without any, with `method` "
        "random_start_projection"
    )


def test_weights_beside_a_description_come_before_the_shipped_ones(hand, tmp_path):
    export_hand(hand, tmp_path)
    prepared = load_hand(tmp_path)  # the folder stands for its hand.urdf
    assert prepared.source == tmp_path / "hand.urdf"
    assert Sampler(prepared).weights_folder == SHIPPED_WEIGHTS / "shadow_lite"
    (tmp_path / "weights").mkdir()  # somebody's folder of that name
    assert Sampler(prepared).weights_folder == SHIPPED_WEIGHTS / "shadow_lite"
    for file in ("config.json", "model.safetensors"):
        shutil.copy(SHIPPED_WEIGHTS / "shadow_lite" / file, tmp_path / "weights")
    sampler = Sampler(prepared)
    assert sampler.weights_folder == tmp_path / "weights"
    assert sampler.prior.config.joint_names == hand.joint_names
    assert Sampler(prepared, weights="elsewhere").weights_folder == Path("elsewhere")
    (tmp_path / "weights" / "model.safetensors").write_bytes(b"cut")
    with pytest.raises(CheckpointError, match="cannot be read"):
        Sampler.from_pretrained(prepared)


def test_weights_are_loaded_only_where_a_method_needs_them(hand, tmp_path):
    sampler = Sampler(hand, weights=tmp_path / "nowhere")
    sampler.load(RANDOM)
    with pytest.raises(CheckpointError, match="no weights for hand"):
        sampler.load(RANDOM, "steered_noise")
    with pytest.raises(UnknownNameError):
        sampler.load("magic")


def test_a_place_beyond_the_last_sample_is_refused(drawn):
    with pytest.raises(IndexError, match="place 99 of 16 samples; expected one from -16 to 15"):
        drawn[99]


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
def test_a_device_that_is_not_there_is_refused(hand):
    with pytest.raises(InputError, match="`device` is 'cuda', but torch and Warp find no CUDA device here"):
        Sampler(hand, device="cuda")


def test_a_random_start_is_projected_to_configurations_that_succeed(hand, scene, drawn):
    assert drawn.q.shape == (16, 9 + hand.num_joints)
    assert drawn.q.dtype == np.float32
    assert drawn.success.any()
    assert not np.isnan(drawn.verdicts.penetration_object).any()
    assert set(drawn.seconds) == {"prepare", "draw", "project", "verify", "rank"}
    assert all(seconds >= 0 for seconds in drawn.seconds.values())
    assert 0 < drawn.reports[0]["projection_converged"] <= 1


def test_the_verdicts_are_those_of_the_draws_and_verified_ones_stand_first(hand, scene, drawn):
    anew = verify(scene, hand, drawn.q.astype(np.float64))
    assert anew.reasons == drawn.reasons
    np.testing.assert_array_equal(anew.force_margin, drawn.verdicts.force_margin)
    assert drawn.success.tolist() == sorted(drawn.success.tolist(), reverse=True)


def test_samples_are_a_sequence(hand, scene, drawn):
    assert len(drawn) == len(list(drawn)) == 16
    best, last = drawn[0], drawn[-1]
    assert isinstance(best, Sample)
    assert (best.success, best.reason) == (True, "")
    assert (last.hand, last.scene, last.reason) == (hand, scene, drawn.reasons[-1])
    np.testing.assert_array_equal(best.q, drawn.q[0])
    np.testing.assert_allclose(best.T_world_palm[:3, 3], best.q[:3])
    assert list(best.joint_angles) == list(hand.joint_names)
    for part in (drawn[2:5], drawn[np.arange(2, 5)], drawn[np.isin(np.arange(16), [2, 3, 4])]):
        assert isinstance(part, Samples)
        np.testing.assert_array_equal(part.q, drawn.q[2:5])
        assert part.reasons == drawn.reasons[2:5]
    assert len(drawn.verified) == drawn.num_verified == drawn.success.sum()
    assert drawn.num_verified + sum(drawn.rejections().values()) == 16
    with pytest.raises(IndexError):
        drawn[16]


def test_a_problem_of_another_scene_is_refused(sampler, scene, problem):
    moved = replace(scene, T_world_object=translation_matrix((0.01, 0.0, 0.0)) @ scene.T_world_object)
    with pytest.raises(InputError, match="`problem` was prepared for another scene"):
        sampler.sample(moved, method=RANDOM, problem=problem)


def test_drawing_goes_on_until_enough_are_verified(sampler, scene, problem):
    found = sampler.sample(scene, problem=problem, method=RANDOM, verified=2, num=4, seed=3)
    assert found.num_verified >= 2
    assert "prepare" not in found.seconds
    assert len(found) % 4 == 0
    few = sampler.sample(scene, problem=problem, method=RANDOM, verified=50, max_draws=5, num=4, seed=3)
    assert len(few) == 5
    np.testing.assert_array_equal(few[few.own_rank == 3].q, sampler.draw(problem, num=4, seed=3, method=RANDOM).q[3:])


def test_a_search_ends_where_nothing_can_be_verified(sampler, scene, problem):
    """A scene that nothing balances: 40 verified draws would be looked for in 32 * 40."""
    blocked = replace(problem, balances=())
    found = sampler.sample(scene, problem=blocked, method=RANDOM, verified=40, num=4, seed=3)
    assert len(found) == 4


def test_what_verification_needs_of_a_hand_is_made_while_little_is_held(hand, prior, scene, monkeypatch):
    steps, made = [], sampler_module.hand_solids
    monkeypatch.setattr(
        sampler_module, "hand_solids", lambda *args, **options: steps.append("hand") or made(*args, **options)
    )
    prepared = sampler_module.PreparedScene.__call__
    monkeypatch.setattr(
        sampler_module.PreparedScene, "__call__", lambda *args: steps.append("scene") or prepared(*args)
    )
    Sampler(hand, weights=prior).sample(scene, num=1, method=RANDOM)
    assert steps == ["hand", "scene"]


def test_the_samplers_own_order_is_worth_something(drawn):
    """Converged ones stand first, and more of the first half succeed."""
    success = drawn.success[np.argsort(drawn.own_rank)]
    assert success[:8].sum() >= success[8:].sum()


def test_the_same_seed_gives_the_same_draws_and_another_others(sampler, scene, drawn):
    again = sampler.sample(scene, num=16, seed=3, method=RANDOM)
    np.testing.assert_array_equal(again.q, drawn.q)
    assert again.reports == drawn.reports
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


def runs_out_above(monkeypatch, most, error):
    """A device whose memory holds `most` draws."""
    draw = Sampler._draw

    def limited(self, problem, *, num, **options):
        if num > most:
            raise error
        return draw(self, problem, num=num, **options)

    monkeypatch.setattr(Sampler, "_draw", limited)


@pytest.mark.parametrize(
    "error",
    [
        torch.OutOfMemoryError("CUDA out of memory"),
        MemoryError("cannot allocate an array"),
        RuntimeError("Failed to allocate 100 bytes on device 'cuda:0'"),
    ],
)
def test_a_batch_that_runs_out_of_memory_is_drawn_in_parts(hand, scene, problem, monkeypatch, error):
    sampler = Sampler(hand)
    runs_out_above(monkeypatch, 3, error)
    with pytest.warns(UserWarning, match="drawn in parts of at most 2: 5 at once ran out of the memory of cpu"):
        samples = sampler.sample(scene, num=5, problem=problem, method=RANDOM)
    parts = [
        sampler.draw(problem, num=size, seed=call_seed(0, call), method=RANDOM).q for call, size in enumerate((2, 2, 1))
    ]
    assert np.array_equal(np.sort(samples.q, axis=0), np.sort(np.concatenate(parts), axis=0))


def test_a_batch_that_would_not_fit_is_not_tried(hand, scene, problem, monkeypatch):
    monkeypatch.setattr("dexnudge.sampling.sampler.free_memory", lambda _: 2.6 * MEMORY_PER_HAND / MEMORY_SHARE)
    runs_out_above(monkeypatch, 2, AssertionError("tried"))
    with pytest.warns(UserWarning, match="drawn in parts of at most 2: 5 at once would not fit into the memory"):
        samples = Sampler(hand).sample(scene, num=5, problem=problem, method=RANDOM)
    assert len(samples) == 5


def test_not_even_one_draw_fits(hand, scene, problem, monkeypatch):
    runs_out_above(monkeypatch, 0, MemoryError("no room"))
    with pytest.raises(InputError, match=r"not even one draw fits into the memory of cpu \(no room\)"):
        Sampler(hand).sample(scene, num=1, problem=problem, method=RANDOM)


def test_other_errors_are_no_want_of_memory(hand, scene, problem, monkeypatch):
    runs_out_above(monkeypatch, 0, RuntimeError("a bug"))
    with pytest.raises(RuntimeError, match="a bug"):
        Sampler(hand).sample(scene, num=2, problem=problem, method=RANDOM)


@contextmanager
def doubles():
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


MODES = {
    "no_grad": torch.no_grad,
    "inference": torch.inference_mode,
    "float64": doubles,
    "meta": partial(torch.device, "meta"),
    "autocast": partial(torch.autocast, "cpu"),
}


@pytest.mark.parametrize("mode", MODES.values(), ids=MODES)
def test_draws_are_the_same_in_whatever_mode_the_caller_is(sampler, scene, drawn, mode):
    expected = sampler.sample(scene, num=2, seed=3)
    with mode():
        before = torch.get_default_dtype(), torch.get_default_device(), torch.is_autocast_enabled("cpu")
        found = sampler.sample(scene, num=16, seed=3, method=RANDOM)
        guided = sampler.sample(scene, num=2, seed=3)
        verdicts = verify(scene, sampler.hand, drawn.q)
        Sampler.from_pretrained(load_hand("shadow_lite"))
        after = torch.get_default_dtype(), torch.get_default_device(), torch.is_autocast_enabled("cpu")
    np.testing.assert_array_equal(found.q, drawn.q)
    np.testing.assert_array_equal(guided.q, expected.q)
    np.testing.assert_array_equal(verdicts.force_margin, drawn.verdicts.force_margin)
    assert before == after


FORKED = """
import multiprocessing, sys, torch
import dexnudge as dn

def draw():
    scene, hand = dn.build_scene("table", "phone"), dn.load_hand("shadow_lite")
    return dn.Sampler(hand).sample(scene, num=2, method="random_start_projection")

def work():
    torch.set_num_threads(int(sys.argv[1]))
    try:
        print(len(draw()), flush=True)
    except dn.InputError as error:
        print(error, flush=True)

torch.set_num_threads(2)
draw()
process = multiprocessing.get_context("fork").Process(target=work)
process.start()
process.join(100)
process.kill()
"""


@pytest.mark.slow
@pytest.mark.parametrize(("threads", "said"), [(2, "this process was forked from one"), (1, "2\n")])
def test_a_forked_process_is_told_to_stand_alone(threads, said):
    done = subprocess.run([sys.executable, "-c", FORKED, str(threads)], capture_output=True, text=True, check=True)
    assert done.stdout.startswith(said)
