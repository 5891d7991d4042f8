"""Criteria of one's own beside the built-in ones: what they decide, and what is wrong with bad ones."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch

import dexnudge as dn
from dexnudge.verification.criteria import check_criteria
from dexnudge.verification.measurements import measure
from dexnudge.verification.penetration import PenetrationCheck

sys.path.append(str(Path(__file__).parents[2] / "examples"))  # an example is a module of one file
from manipulability import Manipulability
from two_digits import DigitsInContact


@pytest.fixture
def presses(upright, tip_height):
    """Four configurations over the block: two that succeed, one too high, one that is no pose."""
    q = np.repeat(upright[None], 4, axis=0)
    q[:, 2] = 0.02 + tip_height + np.array([0.0005, 0.0015, 0.05, 0.001])
    q[3, 0] = np.nan
    return q


@dataclass
class Low:
    """The palm is lower than `limit`."""

    limit: float = 1.0
    name: str = "low"

    def __call__(self, hands, scene):  # noqa: ARG002 - as the protocol has it
        height = hands.T_world_link[:, 0, 2, 3]
        return dn.CriterionResult(height, height < self.limit, "the palm is too high")


def test_nothing_succeeds_that_fails_a_criterion_of_ones_own(boxy_hand, block_scene, presses):
    between = float(presses[:2, 2].mean())
    found = dn.verify(block_scene, boxy_hand, presses, [*dn.default_criteria(), Low(between)])
    assert found.success.tolist() == [True, False, False, False]
    assert found.reasons == ["", "low", "contact", "valid_pose"]
    assert found.sentences["low"] == "the palm is too high"
    assert repr(found) == "Verdicts on 4 configurations: 1 verified; rejected: 1 low, 1 contact, 1 valid_pose"
    np.testing.assert_allclose(found.values["low"], [*presses[:3, 2].tolist(), np.nan])
    assert list(found.values) == [criterion.name for criterion in dn.default_criteria()] + ["low"]


def test_the_first_criterion_that_fails_is_the_reason(boxy_hand, block_scene, presses):
    found = dn.verify(block_scene, boxy_hand, presses, [Low(0.0), *dn.default_criteria()])
    assert found.reasons == ["low", "low", "low", "valid_pose"]


def test_without_the_built_in_criteria_a_configuration_must_still_be_a_pose(boxy_hand, block_scene, presses):
    found = dn.verify(block_scene, boxy_hand, torch.as_tensor(presses), [Low()])
    assert found.reasons == ["", "", "", "valid_pose"]
    assert set(found.values) == {"valid_pose", "low"}
    with pytest.raises(dn.InputError, match="nothing was measured of `force_margin`"):
        found.force_margin  # noqa: B018


def test_the_values_are_those_of_a_verification_without_it(boxy_hand, block_scene, presses):
    plain = dn.verify(block_scene, boxy_hand, presses)
    more = dn.verify(block_scene, boxy_hand, presses, [*dn.default_criteria(), Low()])
    for name, value in plain.values.items():
        np.testing.assert_array_equal(more.values[name], value)
    assert more.reasons == plain.reasons


def test_an_object_that_was_changed_in_place_is_judged_as_it_is_now(boxy_hand, block_scene, presses):
    scene, other = (replace(block_scene, object_mesh=block_scene.object_mesh.copy()) for _ in range(2))
    assert dn.verify(scene, boxy_hand, presses).success[0]
    for each in (scene, other):
        each.object_mesh.vertices[:, 2] += 0.004
    found, expected = (dn.verify(each, boxy_hand, presses) for each in (scene, other))
    assert not found.success[0]
    for name, value in expected.values.items():
        np.testing.assert_allclose(found.values[name], value, atol=1e-8)  # [m] float32 in another order


def test_penetrations_and_contacts_are_measured_once(boxy_hand, block_scene, presses, monkeypatch):
    calls = []
    measure = PenetrationCheck.__call__
    monkeypatch.setattr(
        PenetrationCheck, "__call__", lambda *args, **kwargs: calls.append(1) or measure(*args, **kwargs)
    )
    dn.verify(block_scene, boxy_hand, presses, [*dn.default_criteria(), DigitsInContact(), DigitsInContact(1, "any")])
    assert len(calls) == 1


class Bad:
    """Returns what it is given, or does what it is told."""

    name = "bad"

    def __init__(self, act):
        self.act = act

    def __call__(self, hands, scene):  # noqa: ARG002 - as the protocol has it
        return self.act(len(hands))


def result(value=None, passed=None):
    value = np.zeros(3) if value is None else value
    return lambda n: dn.CriterionResult(value, np.ones(n, dtype=bool) if passed is None else passed)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (result(value=np.zeros(2)), r"returned value as float64 of shape \(2,\) for 3 hands; expected real numbers"),
        (result(value=np.zeros(3, dtype=complex)), "returned value as complex128 of shape"),
        (result(value=np.array(["a", "b", "c"])), "returned value as <U1 of shape"),
        (result(passed=np.ones(3)), r"returned passed as float64 of shape \(3,\) for 3 hands; expected bool of shape"),
        (result(passed=np.ones((3, 1), dtype=bool)), r"returned passed as bool of shape \(3, 1\)"),
        (lambda n: np.ones(n, dtype=bool), "returned a ndarray; expected CriterionResult"),
        (lambda n: None, "returned a NoneType; expected CriterionResult"),
    ],
)
def test_a_result_that_does_not_fit_is_named(boxy_hand, block_scene, presses, act, message):
    with pytest.raises(dn.InputError, match=f"criterion 'bad' {message}"):
        dn.verify(block_scene, boxy_hand, presses, [Bad(act)])


def test_an_error_of_a_criterion_is_kept_as_the_cause(boxy_hand, block_scene, presses):
    with pytest.raises(dn.InputError, match="criterion 'bad' failed: ZeroDivisionError: division by zero") as caught:
        dn.verify(block_scene, boxy_hand, presses, [Bad(lambda n: 1 / 0)])
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


class Meddling:
    """Changes what it is given."""

    name = "meddling"

    def __init__(self, act):
        self.act = act

    def __call__(self, hands, scene):
        self.act(hands, scene)
        return dn.CriterionResult(np.zeros(len(hands)), np.ones(len(hands), dtype=bool))


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda hands, _: hands.q.data.add_(1.0), "changed the hands or the scene"),
        (lambda hands, _: hands.T_world_link.data.mul_(2.0), "changed the hands or the scene"),
        (lambda _, scene: scene.object_mesh.apply_translation((0.0, 0.0, 0.05)), "changed the hands or the scene"),
        (lambda _, scene: scene.T_world_object.__setitem__((0, 3), 1.0), "changed the hands or the scene"),
        (lambda hands, scene: measure(hands, scene).penetrations.object.fill(0.0), "read-only"),
    ],
)
def test_what_a_criterion_changes_is_told(boxy_hand, block_scene, presses, act, message):
    scene = replace(
        block_scene, object_mesh=block_scene.object_mesh.copy(), T_world_object=block_scene.T_world_object.copy()
    )
    with pytest.raises(dn.InputError, match=f"criterion 'meddling' .*{message}"):
        dn.verify(scene, boxy_hand, presses, [Meddling(act), *dn.default_criteria()])


def test_numbers_of_torch_s_own_are_read_and_devices_are_checked(boxy_hand, block_scene, presses):
    whole = dn.verify(block_scene, boxy_hand, torch.from_numpy(presses).bfloat16())
    rounded = torch.from_numpy(presses).bfloat16().double().numpy()
    np.testing.assert_array_equal(whole.success, dn.verify(block_scene, boxy_hand, rounded).success)
    for device in ("cuda:99", "tpu"):
        with pytest.raises(dn.InputError, match="`device` is"):
            dn.verify(block_scene, boxy_hand, presses, device=device)


def test_a_value_that_is_nan_is_no_error_and_counts_by_what_passed(boxy_hand, block_scene, presses):
    found = dn.verify(block_scene, boxy_hand, presses, [Bad(result(value=np.full(3, np.nan)))])
    assert found.success.tolist() == [True, True, True, False]


@pytest.mark.parametrize("name", ["q", "success", "reasons", "joint_names", "contact_links", "file", "force_margin"])
def test_a_name_that_is_taken(name):
    with pytest.raises(dn.InputError, match=f"the name of criterion '{name}' is taken"):
        check_criteria([Low(name=name)])


def test_two_criteria_of_one_name():
    with pytest.raises(dn.InputError, match="the name of criterion 'low' is taken"):
        check_criteria([*dn.default_criteria(), Low(), Low()])


@pytest.mark.parametrize("name", ["", "two words", "1st", "a-b", "class", 3])
def test_a_name_that_is_no_identifier(name):
    with pytest.raises(dn.InputError, match="has no usable name; expected an identifier"):
        check_criteria([Low(name=name)])


@pytest.mark.parametrize("tolerance", ["x", -1, -1e-9, np.nan, np.inf, None, True])
def test_a_tolerance_that_is_none(tolerance):
    criterion = Low()
    criterion.tolerance = tolerance
    with pytest.raises(
        dn.InputError, match=r"the `tolerance` of criterion 'low' is .*; expected a finite number, 0 or"
    ):
        check_criteria([criterion])


@pytest.mark.parametrize("thing", [Low, 3, "low", lambda hands, scene: None])
def test_what_is_no_criterion(thing):
    with pytest.raises(dn.InputError, match=r"entry 0 of `criteria` is .*; expected an object with a `name`"):
        check_criteria([thing])


def test_no_criterion_is_asked_about_no_hands(boxy_hand, block_scene):
    found = dn.verify(block_scene, boxy_hand, np.full((2, 13), np.nan), [*dn.default_criteria(), Bad(lambda n: 1 / 0)])
    assert found.reasons == ["valid_pose"] * 2
    assert found.force_margin.tolist() == [0.0, 0.0]


def test_the_digits_that_touch_are_counted(boxy_hand, block_scene, presses):
    q = presses[:3].copy()
    q[1, 0] = 0.08 + 0.009  # one finger is beside the block
    found = dn.verify(block_scene, boxy_hand, q, [DigitsInContact()])
    assert found.values["digits_in_contact"].tolist() == [2.0, 1.0, 0.0]
    assert found.reasons == ["", "digits_in_contact", "digits_in_contact"]


def test_manipulability_is_that_of_finite_differences_and_tells_a_straight_digit():
    """A straight digit cannot move its tip nearer to its base."""
    hand, scene = dn.load_hand("shadow_lite"), dn.build_scene("table", "phone", seed=0)
    q = torch.zeros(2, 25, dtype=torch.float64)
    q[:, 3] = q[:, 7] = 1.0
    q[1, 9:] = torch.as_tensor(0.5 * (hand.lower + hand.upper))
    q = hand.clamp(q)
    hands = dn.HandBatch(hand, q)
    dn.measure(hands, scene).contact_links[:] = [["ffdistal"], ["ffdistal"]]
    value = Manipulability()(hands, scene).value
    digit, step = list(hand.fingertips).index("FF"), 1e-6
    for row, each in enumerate(q):
        moved = each + step * torch.eye(25, dtype=torch.float64)[9:]
        jacobian = ((hand.keypoints(moved) - hand.keypoints(each[None]))[:, digit] / step).T.numpy()
        reference = np.sqrt(max(np.linalg.det(jacobian @ jacobian.T), 0.0))
        assert float(value[row]) == pytest.approx(reference, rel=1e-3, abs=1e-10)
    assert value[0] < Manipulability().least < value[1]
