"""Energy terms of one's own: their gradient in the frame of the descent, and what is refused by name."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from moves import retract, rotation_vector_to_matrix

from dexnudge.energies.descent import HandPose
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.kernel_inputs import build_scene_fields
from dexnudge.energies.terms import TermEnergy, TermWeights, check_terms
from dexnudge.errors import InputError
from dexnudge.scenes.scene import Scene

BATCH = 3
OFF = TermWeights(environment=0.0, object=0.0, self=0.0, contact=0.0)


@dataclass(frozen=True)
class Term:
    """Any function as a term."""

    function: Any
    name: Any = "mine"
    weight: Any = 1.0

    def __call__(self, hands, scene):
        return self.function(hands, scene)


def toward_the_object(hands, scene):
    """Differs with every coordinate: squared distances of the surface points from the object, and a pull on the joints."""
    centre = torch.as_tensor(scene.T_world_object[:3, 3], dtype=hands.q.dtype)
    spread = torch.linspace(0.5, 2.0, hands.points.shape[1])
    pull = (hands.joint_angles * torch.arange(1, hands.joint_angles.shape[1] + 1)).sin().sum(dim=1)
    return (spread * (hands.points - centre).square().sum(dim=2)).mean(dim=1) + 0.01 * pull


@pytest.fixture(scope="module")
def scene():
    pose = np.eye(4)
    pose[:3, 3] = 0.1, 0.2, 0.3
    return Scene(
        trimesh.creation.box((0.1, 0.05, 0.01)), trimesh.creation.box((1.0, 1.0, 0.1)), pose, np.array([1.0, 0, 0])
    )


@pytest.fixture(scope="module")
def T_world_frame():
    """A frame that is turned and moved, so that no mistake between the two frames goes unseen."""
    frame = np.eye(4)
    frame[:3, :3] = rotation_vector_to_matrix(torch.tensor([0.3, -0.8, 1.1], dtype=torch.float64)).numpy()
    frame[:3, 3] = 0.2, -0.1, 0.4
    return frame


@pytest.fixture(scope="module")
def pose(boxy_hand):
    generator = torch.Generator().manual_seed(0)
    rotation = rotation_vector_to_matrix(torch.randn(BATCH, 3, generator=generator))
    angles = 0.5 * torch.rand(BATCH, boxy_hand.num_joints, generator=generator)
    angles[:, 1] = angles[:, 0] - 0.2  # inside the coupling, whose clamp has no derivative
    return HandPose(0.1 * torch.randn(BATCH, 3, generator=generator), rotation, angles)


def test_the_gradient_is_that_of_finite_differences_along_each_move(boxy_hand, scene, T_world_frame, pose):
    """Moves of the descent itself, in its own frame; the term sees hands in the world."""
    energy = TermEnergy([Term(toward_the_object, weight=3.0)], boxy_hand, scene, T_world_frame)
    value, gradient = energy(pose)
    size = 2e-3
    for column in range(6 + boxy_hand.num_joints):
        move = torch.zeros(BATCH, 6 + boxy_hand.num_joints)
        move[:, column] = size
        ahead, behind = (energy(retract(boxy_hand, pose, sign * move))[0] for sign in (1, -1))
        torch.testing.assert_close(gradient[:, column], (ahead - behind) / (2 * size), rtol=0.01, atol=2e-3)
    assert (gradient.abs().amax(dim=0) > 1e-3).all(), "every coordinate matters to this term"
    assert (value > 0).all()


def test_a_term_is_given_hands_in_the_world(boxy_hand, scene, T_world_frame, pose):
    seen = []

    def look(hands, given):
        seen.append((hands, given))
        return hands.q.square().sum(dim=1)

    TermEnergy([Term(look)], boxy_hand, scene, T_world_frame)(pose)
    ((hands, given),) = seen
    assert given is scene
    for row in range(BATCH):
        palm = np.eye(4)
        palm[:3, :3], palm[:3, 3] = pose.rotation[row].numpy(), pose.translation[row].numpy()
        np.testing.assert_allclose(hands.T_world_link[row, 0].detach().numpy(), T_world_frame @ palm, atol=1e-6)
    torch.testing.assert_close(hands.joint_angles.detach(), pose.joint_angles)


def test_hand_energy_adds_terms_to_the_kernels(boxy_hand, scene, pose):
    fields = build_scene_fields(scene.object_in_world(), scene.environment_mesh)
    near = replace(pose, translation=pose.translation + torch.tensor([0.1, 0.2, 0.35]))
    one, other = (
        Term(toward_the_object, weight=2.0),
        Term(lambda hands, _: hands.points[:, :, 2].mean(dim=1), name="low"),
    )
    plain, both = (HandEnergy(boxy_hand, fields, BATCH, terms=terms) for terms in (None, "later"))
    both.terms = TermEnergy([one, other], boxy_hand, scene, np.eye(4))
    kernel, total = plain(near), both(near)
    value, slope = both.terms(near)
    apart = [TermEnergy([term], boxy_hand, scene, np.eye(4))(near) for term in (one, other)]
    torch.testing.assert_close(value, apart[0][0] + apart[1][0])
    torch.testing.assert_close(slope, apart[0][1] + apart[1][1])
    assert torch.equal(total, kernel + value)
    assert torch.equal(both.energy, plain.energy)
    torch.testing.assert_close(both.gradient, plain.gradient + slope)


def test_a_hand_that_is_skipped_keeps_its_results(boxy_hand, scene, pose):
    fields = build_scene_fields(scene.object_in_world(), None)
    energy = HandEnergy(
        boxy_hand, fields, BATCH, OFF, terms=TermEnergy([Term(toward_the_object)], boxy_hand, scene, np.eye(4))
    )
    before, gradient = energy(pose).clone(), energy.gradient.clone()
    energy.active.copy_(torch.tensor([1, 0, 1]))
    moved = replace(pose, translation=pose.translation + 0.1)
    after = energy(moved)
    assert (after != before).tolist() == [True, False, True]
    assert (energy.gradient != gradient).any(dim=1).tolist() == [True, False, True]
    energy.active.zero_()
    assert torch.equal(energy(pose), after)


def fails(_hands, _scene):
    return {}["nothing"]


def writes_into_its_hands(hands, _):
    value = hands.q.square().sum(dim=1)
    hands.q[:, 0] = 0.0
    return value


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda hands, _: hands.q.sum(dim=1) / 0.0, "is NaN or infinite at 3 of 3 hands"),
        (
            lambda hands, _: (hands.q[:, 0] - hands.q[:, 0]).sqrt(),
            "has a gradient that is NaN or infinite at 3 of 3 hands",
        ),
        (lambda hands, _: hands.q.sum(), r"returned shape \(\); expected \(3,\)"),
        (lambda hands, _: hands.points.norm(dim=2), r"returned shape \(3, \d+\); expected \(3,\)"),
        (lambda hands, _: (hands.q > 0).sum(dim=1), "returned torch.int64"),
        (lambda hands, _: hands.q.detach().numpy().sum(axis=1), "returned a ndarray"),
        (lambda hands, _: None, "returned a NoneType"),
        (lambda hands, _: torch.ones(len(hands)), "has no gradient in the configuration"),
        (lambda hands, _: torch.ones(len(hands), requires_grad=True) * 2, "has no gradient in the configuration"),
        (lambda hands, _: hands.q.detach().sum(dim=1), "has no gradient in the configuration"),
        (fails, "failed: KeyError: 'nothing'"),
        (lambda hands: hands, "failed: TypeError"),
        (writes_into_its_hands, "failed: RuntimeError"),
    ],
)
def test_a_term_of_no_use_is_named(boxy_hand, scene, pose, function, message):
    good = Term(toward_the_object, name="good")
    with pytest.raises(InputError, match=f"^energy term 'culprit' {message}"):
        TermEnergy([good, Term(function, name="culprit")], boxy_hand, scene, np.eye(4))(pose)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": ""}, "term 1 of `terms`, a Term, has the name ''"),
        ({"name": 7}, "has the name 7"),
        ({"weight": 0.0}, "the weight of term 'culprit' is 0.0"),
        ({"weight": float("nan")}, "the weight of term 'culprit' is nan"),
        ({"weight": "1"}, "the weight of term 'culprit' is '1'"),
        ({"name": "good"}, "two terms are named 'good'"),
    ],
)
def test_names_and_weights_that_make_no_sense(changes, message):
    good, bad = Term(toward_the_object, name="good"), replace(Term(toward_the_object, name="culprit"), **changes)
    with pytest.raises(InputError, match=message):
        check_terms([good, bad])


def test_what_is_no_term_is_refused():
    with pytest.raises(InputError, match="a function, has the name None"):
        check_terms([toward_the_object])
    with pytest.raises(InputError, match="cannot be called"):
        check_terms([type("Named", (), {"name": "silent", "weight": 1.0})()])


def test_double_precision_is_taken(boxy_hand, scene, pose):
    """A term that adds numpy constants gets there without meaning to."""
    offset = torch.as_tensor(np.array([0.1, 0.2, 0.3]))
    value, gradient = TermEnergy(
        [Term(lambda hands, _: (hands.q[:, :3] - offset).square().sum(dim=1))], boxy_hand, scene, np.eye(4)
    )(pose)
    assert value.dtype == gradient.dtype == torch.float32
    torch.testing.assert_close(gradient[:, :3], 2 * (pose.translation - offset.float()))
