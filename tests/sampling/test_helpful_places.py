"""Places that help a turn: what a force there gains, against a search over forces, and fingertips that go there."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dexnudge.energies.force_residual import ForceResidual
from dexnudge.sampling.helpful_places import STRIDE
from dexnudge.sampling.problem import TIP_RADIUS, prepare
from dexnudge.sampling.projection import ProjectionConfig, project
from dexnudge.sampling.random_start import random_start
from dexnudge.scenes.families import build_scene
from dexnudge.verification.verdicts import verify
from force_balance import solve


@pytest.fixture(scope="module")
def turning():
    return prepare(build_scene("turn", "phone", seed=0))


@pytest.fixture(scope="module")
def untouched(turning):
    """The balance without a hand."""
    return balanced(turning, torch.zeros(1, 4, 3), torch.zeros(1, 4, 3), torch.zeros(1, 4))


def balanced(problem, points, normals, counts) -> ForceResidual:
    force = ForceResidual(problem.balances, torch.ones(1, dtype=torch.int32), 4)
    solve(force, points, normals, counts, sweeps=2000)
    return force


def test_a_slide_asks_for_no_more_fingertips():
    assert prepare(build_scene("table", "phone", seed=0)).helpful is None


def test_help_is_the_best_single_force_of_a_search(turning, untouched):
    r = untouched.wrench[0, 0].double().numpy()
    assert np.linalg.norm(r) > 0.2, "friction is missing"
    found = turning.helpful.help(untouched.wrench)[0].double().numpy()
    forces = np.linspace(0.0, turning.helpful.max_normal, 4001)
    for place in range(0, len(found), 40):
        wrenches = turning.helpful.wrenches[0, place].double().numpy()
        left = 0.5 * ((r + forces[:, None, None] * wrenches) ** 2).sum(axis=-1).min()
        assert found[place] == pytest.approx(0.5 * r @ r - left, abs=1e-4)


def test_one_free_fingertip_is_drawn_and_where_it_arrives_the_residual_falls_by_what_was_promised(turning, untouched):
    helpful = turning.helpful
    gain = helpful.help(untouched.wrench)[0]
    place = int(gain.argmax())
    tips = torch.full((1, 4, 3), 0.3)
    tips[0, 3] = helpful.places[place]
    drawn, target = helpful(untouched.wrench, untouched.loaded, tips)
    assert drawn.tolist() == [[False, False, False, True]]
    assert ((target - tips).norm(dim=2) <= STRIDE + 1e-6).all()
    reached = int((helpful.places - target[0, 3]).norm(dim=1).argmin())
    normals = torch.zeros(1, 4, 3)
    normals[..., 2] = 1.0
    points = torch.zeros(1, 4, 3)
    normals[0, 3] = helpful.normals[reached]
    points[0, 3] = helpful.places[reached] - TIP_RADIUS * helpful.normals[reached]
    touched = balanced(turning, points, normals, torch.tensor([[0.0, 0.0, 0.0, 1.0]]))
    before, after = (0.5 * float(each.residual.square()) for each in (untouched, touched))
    assert before - after >= float(gain[reached]) - 1e-3
    assert touched.loaded.tolist() == [[False, False, False, True]]
    assert not helpful(touched.wrench, touched.loaded, tips)[0][0, 3], "what carries force stays"


@pytest.fixture(scope="module")
def pulled():
    return prepare(build_scene("book", "phone", seed=1))


def test_what_is_pulled_is_balanced_where_its_slide_ends_on_the_board_alone_in_worlds_that_lean(pulled):
    tip, *slides = pulled.balances
    angle = pulled.scene.turn.angle
    to_world = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    sideways = []
    for slide in slides:
        down = to_world @ slide.gravity.numpy()  # the hand sees it from the tipped object, whose tip is about y
        assert down[2] == pytest.approx(-np.cos(np.radians(5.0)), abs=1e-6)
        sideways.append(down[1])
        wrenches = slide.support_wrenches.numpy()[:, :3] @ to_world.T
        np.testing.assert_allclose(wrenches[:, 1:], np.tile([0.0, 1.0], (len(wrenches), 1)), atol=1e-6)
        assert slide.friction_hand < pulled.scene.friction_hand
    np.testing.assert_allclose(sorted(sideways), np.sin(np.radians([-5.0, 5.0])), atol=1e-6)
    np.testing.assert_allclose(tip.gravity, [0.0, 0.0, -1.0], atol=1e-6)


def test_fingertips_are_drawn_to_the_sides_and_the_top_of_what_is_pulled(pulled):
    assert len(pulled.helpful.places) > 0
    assert pulled.helpful.normals[:, 0].abs().max() < 0.5


@pytest.mark.slow
def test_more_hands_can_tip_a_book_when_free_fingertips_help(hand):
    """Random hands, judged; the same projection without the pull is the reference."""
    scene = build_scene("book", "phone", seed=1)
    problem = prepare(scene)
    starts = random_start(hand, problem.cloud, count=32, generator=torch.Generator().manual_seed(0))
    margins = {}
    for name, used in (("with", problem), ("without", replace(problem, helpful=None))):
        q, _ = project(hand, used, starts, config=ProjectionConfig())
        margins[name] = verify(scene, hand, problem.to_world(q).astype(np.float64)).force_margin
    assert (margins["with"] >= 1.0).mean() > (margins["without"] >= 1.0).mean()
