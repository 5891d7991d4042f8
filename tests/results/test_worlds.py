"""Configurations that must hold where frictions, mass and place of a block are not what they are said to be."""

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from dexnudge.cli.main import main
from dexnudge.hands.registry import load_hand
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.results.checking import check
from dexnudge.results.ranking import ranking
from dexnudge.results.samples import Samples
from dexnudge.results.worlds import MEASURED, balanced_in, sampled_worlds, share_of_worlds, what_to_do
from dexnudge.sampling.problem import prepare
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.boxes import box
from dexnudge.scenes.families import build_scene
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.uncertainty import Uncertainty
from dexnudge.verification.verdicts import verify

TIP = 0.011 + 0.032 + 0.03  # [m] from the palm's centre down to the fingertips of the boxy hand, 10 mm wide
SIZE = 0.16, 0.08, 0.02  # [m] of the block


@pytest.fixture
def scene():
    """A block on a floor with a noise of 0.5 mm, to be moved along x."""
    pose = np.eye(4)
    pose[2, 3] = SIZE[2] / 2
    floor = box((-0.4, -0.4, -0.02), (0.4, 0.4, 0.0))
    motion = np.array([1.0, 0.0, 0.0])
    return Scene(trimesh.creation.box(SIZE), floor, pose, motion, surface_noise=0.0005, clearance=0.001)


def presses(*places):
    """q of the boxy hand with both fingertips 1 mm over the block's top, its palm at these x, y [m]."""
    q = np.zeros((len(places), 13))
    q[:, 3] = q[:, 7] = 1.0
    q[:, :3] = [[x, y, SIZE[2] + TIP + 0.001] for x, y in places]
    return q


MIDDLE, AT_THE_SIDE = (0.01, 0.0), (0.0, SIZE[1] / 2 + 0.004)  # of the latter, 1 mm of the fingertips is over the block


def test_the_object_is_displaced_and_turned_on_its_support_within_what_is_said(scene):
    centre = sliding_task(scene).centre
    found = sampled_worlds(scene, MEASURED)
    moves = 1e3 * np.array([sliding_task(each).centre - centre for each in found])
    away = np.linalg.norm(moves[:, :2], axis=1)
    assert 1.7 < away.max() <= 2.0
    np.testing.assert_allclose(np.sort(away**2 / 4.0), (np.arange(16) + 0.5) / 16, atol=1 / 16)  # evenly over the disk
    assert 0.25 < np.abs(moves[:, 2]).max() <= 0.3
    assert np.abs(moves.mean(axis=0)).max() < 0.15
    turns = [np.degrees(np.arctan2(each.T_world_object[1, 0], each.T_world_object[0, 0])) for each in found]
    np.testing.assert_allclose(np.sort(turns), np.linspace(-1, 1, 33)[1::2], atol=1 / 16)
    assert all(each.environment_mesh is scene.environment_mesh for each in found)  # and so are its trees


def test_frictions_and_mass_are_spread_evenly_over_their_ranges_by_the_seed(scene):
    uncertainty = Uncertainty(friction=(0.5, 1.0), friction_environment=(1.0, 1.5), mass=(0.5, 2.0), worlds=17)
    *found, hardest = sampled_worlds(scene, uncertainty)
    strata = (np.arange(16) + 0.5) / 16
    for name, low, width in (("friction_hand", 0.4, 0.4), ("friction_environment", 0.4, 0.2), ("mass", 0.075, 0.225)):
        shares = (np.array([getattr(each, name) for each in found]) - low) / width
        np.testing.assert_allclose(np.sort(shares), strata, atol=1 / 32 + 1e-9)
    assert all(each.max_normal_force == scene.max_normal_force for each in found)
    assert all((each.T_world_object == scene.T_world_object).all() for each in found)
    assert (hardest.friction_hand, hardest.friction_environment, hardest.mass) == pytest.approx((0.4, 0.6, 0.3))
    again, other = (sampled_worlds(scene, replace(uncertainty, seed=seed))[:-1] for seed in (0, 1))
    assert [each.mass for each in again] == [each.mass for each in found] != [each.mass for each in other]


def test_what_holds_in_all_worlds_is_ranked_as_in_the_hardest():
    sampler = Sampler(load_hand("shadow_lite"))
    layers = build_scene("layers", "phone", seed=0)
    scene = replace(layers, uncertainty=Uncertainty(friction=(0.6, 1.0)))
    q = sampler.draw(prepare(scene), num=16, seed=0).q
    hardest = replace(layers, friction_hand=0.6 * layers.friction_hand)
    here, there = (verify(each, sampler.hand, q) for each in (scene, hardest))
    ranked = ranking(scene, here, sampler.hand, q)
    holding = ranked.order[ranked.foresight["share_of_worlds"][ranked.order] == 1.0]
    assert len(holding) > 5
    in_hardest = ranking(hardest, there, sampler.hand, q).order
    assert holding.tolist() == [row for row in in_hardest if row in holding]
    assert holding.tolist() != [row for row in ranking(layers, here, sampler.hand, q).order if row in holding]


def test_where_a_wall_stands_the_object_cannot_lie(scene):
    wall = box((-0.4, SIZE[1] / 2, 0.0), (0.4, 0.3, 0.05))
    walled = replace(scene, environment_mesh=trimesh.util.concatenate([scene.environment_mesh, wall]))
    found = sampled_worlds(walled, MEASURED)
    assert 3 <= len(found) < 16
    toward = [max(each.T_world_object[1, 3] for each in sampled_worlds(one, MEASURED)) for one in (scene, walled)]
    assert toward[0] > 0.0015
    assert toward[1] < 0.0013  # by what a body may graze


def test_what_holds_in_all_worlds_comes_first(scene, boxy_hand):
    q = presses(AT_THE_SIDE, MIDDLE)
    verdicts = verify(scene, boxy_hand, q)
    assert verdicts.success.all()
    share = share_of_worlds(scene, boxy_hand, q, verdicts, np.arange(2))
    assert share[1] == 1.0
    assert 0.25 <= share[0] <= 0.9  # it loses the block where that lies 1 mm or more to the other side
    model = replace(scene, surface_noise=0.0)
    assert ranking(model, verdicts, boxy_hand, q).order.tolist() == [0, 1]  # the other one pushes ahead of the centre
    found = ranking(scene, verdicts, boxy_hand, q)
    assert found.order.tolist() == [1, 0]
    assert found.out_of_order().tolist() == [1]
    assert not len(ranking(scene, verdicts.take(np.array([1, 0])), boxy_hand, q[::-1].copy()).out_of_order())
    assert share_of_worlds(model, boxy_hand, q, verdicts, np.arange(2)).tolist() == [1.0, 1.0]


def test_what_is_just_within_a_limit_holds_where_the_object_lies_no_higher(scene, boxy_hand):
    q = presses(MIDDLE, MIDDLE)
    q[:, 2] -= [0.001 + 0.0006, 0.001 + 0.0009]  # fingertips 0.6 mm and 0.9 mm in the block, of 1 mm that is allowed
    verdicts = verify(scene, boxy_hand, q)
    assert verdicts.success.all()
    heights = np.array([each.T_world_object[2, 3] for each in sampled_worlds(scene, MEASURED)]) - SIZE[2] / 2
    expected = [1.0, (heights <= 0.0001).mean()]
    np.testing.assert_allclose(share_of_worlds(scene, boxy_hand, q, verdicts, np.arange(2)), expected)


def test_a_press_holds_in_the_share_of_worlds_that_its_closed_form_gives(scene, boxy_hand):
    """N >= mu_e m g / (mu_h - mu_e), with two fingertips of 5 N."""
    uncertainty = Uncertainty(friction=(0.5, 1.0), friction_environment=(1.0, 1.5), mass=(0.5, 4.0), worlds=64)
    model = replace(scene, surface_noise=0.0, uncertainty=uncertainty)
    q = presses(MIDDLE)
    verdicts = verify(model, boxy_hand, q)
    held = []
    for world in sampled_worlds(model, uncertainty):
        slack = world.friction_hand - world.friction_environment
        held.append(slack > 0 and world.friction_environment * world.mass * 9.81 / slack <= 2 * world.max_normal_force)
    assert 0.2 < np.mean(held) < 0.8
    assert share_of_worlds(model, boxy_hand, q, verdicts, np.arange(1))[0] == np.mean(held)
    assert "no press moves the object there, only pushes and hooks do" in what_to_do(model, float(np.mean(held)))


def test_other_frictions_and_masses_give_what_verifying_there_gives(scene, boxy_hand):
    q = presses(AT_THE_SIDE, MIDDLE, (0.3, 0.3))
    verdicts = verify(scene, boxy_hand, q)
    worlds = [{"mass": 1.2}, {"friction_hand": 0.45}, {"friction_environment": 0.7, "max_normal_force": 9.0}]
    expected = [verify(replace(scene, **world), boxy_hand, q).success for world in worlds]
    np.testing.assert_array_equal(balanced_in(scene, verdicts, worlds), expected)
    assert 0 < np.sum(expected) < 6


def test_check_finds_the_order_again(scene, boxy_hand, tmp_path):
    q = presses(AT_THE_SIDE, MIDDLE, (0.3, 0.3)).astype(np.float32)
    samples = Samples(scene, boxy_hand, q, verify(scene, boxy_hand, q))
    saved = samples.save(tmp_path / "out")
    np.testing.assert_array_equal(saved.q[0], q[1])
    assert check(tmp_path / "out").agrees
    assert saved.foresight["share_of_worlds"][0] == 1.0
    assert saved[0].share_of_worlds == 1.0
    assert np.isnan(saved[2].share_of_worlds)
    with np.load(tmp_path / "out" / "configurations.npz") as archive:
        swapped = {name: array[[1, 0, 2]] if len(array) == 3 else array for name, array in archive.items()}
    np.savez(tmp_path / "out" / "configurations.npz", **swapped)
    assert (
        "configuration 1 is better than the one before it; expected the best first"
        in check(tmp_path / "out").differences
    )


def test_check_finds_a_share_of_worlds_that_is_not_true(scene, boxy_hand, tmp_path, capsys):
    uncertain = replace(scene, surface_noise=0.0, uncertainty=Uncertainty(friction=(0.25, 1.0), worlds=8))
    q = presses(MIDDLE).astype(np.float32)
    saved = Samples(uncertain, boxy_hand, q, verify(uncertain, boxy_hand, q)).save(tmp_path / "out")
    frictions = np.array(
        [world.friction_hand for world in sampled_worlds(uncertain, uncertain.uncertainty)]
    )  # 0.2 to 0.8
    holds = frictions > 0.4 + 0.4 * 0.15 * 9.81 / 10.0  # mu_h - mu_e >= mu_e m g / N
    assert saved[0].share_of_worlds == holds.mean()
    assert 0 < holds.sum() < 8
    assert main(["check", str(tmp_path / "out")]) == 0
    (row,) = [line for line in capsys.readouterr().out.splitlines() if "share_of_worlds" in line]
    assert re.findall(r"\d\.\d{3}", row) == [f"{holds.mean():.3f}"] * 2 + ["0.000"]
    with np.load(tmp_path / "out" / "configurations.npz") as archive:
        arrays = dict(archive)
    arrays["share_of_worlds"] = np.ones(1)
    np.savez(tmp_path / "out" / "configurations.npz", **arrays)
    (difference,) = check(tmp_path / "out").differences
    share = f"{saved[0].share_of_worlds:.3f}"
    assert difference == f"configuration 0: share_of_worlds is 1.000 in the file, {share} found"
