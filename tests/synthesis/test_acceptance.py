"""What is kept, against HiGHS, against the judge, and on hands whose verdict is plain."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from dexnudge.dataset.schema import INFEASIBLE, NUM_DIRECTIONS, TURNS, best_direction, direction_angles
from dexnudge.mechanics.balance import balance_problem, solve_balance
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.friction_cone import friction_cone_edges, wrenches
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.scenes.support_contacts import support_contacts
from dexnudge.simulation.model import GRASP_FRICTION
from dexnudge.synthesis.acceptance import (
    GraspVerifier,
    NonPrehensileVerifier,
    behaviour_of,
    floating_scene,
    resting_scene,
)
from dexnudge.verification.verdicts import verify

LET_GO, TURNED = 0.05, np.radians(15.0)  # [m] and [rad]: DexGraspBench's limits
GEOMETRY = {"penetration object", "penetration environment", "penetration self", "no contact"}
NO_TURN = np.full(len(TURNS), INFEASIBLE)
PHYSICS = {"no squeeze", "drops", "diverges"}  # of a grasp whose geometry is right

pytestmark = pytest.mark.slow  # a batch of hands is generated and verified first


@pytest.fixture(scope="module")
def grasps(hand, phone):
    return GraspVerifier(hand, floating_scene(phone))


@pytest.fixture(scope="module")
def pushes(hand, phone):
    return NonPrehensileVerifier(hand, resting_scene(phone))


@pytest.fixture(scope="module")
def kept(generated):
    """q of the kept rows that push, press or hook, and their stored margins."""
    rows = [row for row in generated.rows if row.behaviour != "grasp"]
    return np.stack([row.q for row in rows]).astype(np.float64), np.stack([row.direction_margin for row in rows])


@pytest.fixture(scope="module")
def grasped(generated):
    """The kept grasps."""
    return [row for row in generated.rows if row.behaviour == "grasp"]


def patches(*places: tuple[list[float], list[float]], size: float = 0.006) -> HandContacts:
    """Contacts of one link each: four points about a place, across its outward normal."""
    points, normals, link = [], [], []
    for index, (place, normal) in enumerate(places):
        helper = np.eye(3)[int(np.argmin(np.abs(normal)))]
        one = np.cross(normal, helper)
        for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            points.append(np.asarray(place) + size * (a * one + b * np.cross(normal, one)))
            normals.append(normal)
            link.append(index)
    return HandContacts(points=np.asarray(points), normals=np.asarray(normals, dtype=float), link=np.asarray(link))


def can_squeeze(contacts: HandContacts, centre: np.ndarray) -> bool:
    """Whether any forces within the friction pyramids add up to nothing without being nothing, by HiGHS."""
    edges = friction_cone_edges(contacts.normals, np.asarray([0.0, 0.0, 1.0]), friction=GRASP_FRICTION)
    columns = wrenches(contacts.points[:, None], edges, centre=centre, half_length=0.1).reshape(-1, 6).T
    count = columns.shape[1]
    found = linprog(-np.ones(count), A_ub=np.ones((1, count)), b_ub=[1.0], A_eq=columns, b_eq=np.zeros(6))
    assert found.status == 0
    return bool(-found.fun > 0.5)  # the sum is 0 or, since all forces may grow alike, 1


def test_kept_grasps_hold_again_and_drift_as_stored(grasps, grasped):
    assert len(grasped) >= 3
    verdict = grasps(np.stack([row.q for row in grasped]))
    assert verdict.reason == [""] * len(grasped)
    assert verdict.kept.all()
    # In a batch of another size the last bits of the kinematics differ, and contact dynamics make them grow.
    np.testing.assert_allclose(verdict.hold_translation, [row.hold_translation for row in grasped], rtol=0, atol=5e-4)
    np.testing.assert_allclose(verdict.hold_rotation, [row.hold_rotation for row in grasped], rtol=0, atol=5e-3)
    assert (verdict.direction_margin == INFEASIBLE).all()
    for row in grasped:
        assert 0.0 < row.hold_translation < LET_GO
        assert 0.0 < row.hold_rotation < TURNED


def test_a_hand_that_opens_does_not_hold(hand, grasps, grasped):
    opened = np.stack([row.q for row in grasped])
    angles = dict.fromkeys(hand.joint_names, 0.0) | {"THJ5": -0.5, "THJ2": -0.5, "THJ1": -0.2}
    opened[:, 9:] = [angles[name] for name in hand.joint_names]
    verdict = grasps(opened)
    assert not verdict.kept.any()
    assert set(verdict.reason) <= GEOMETRY | PHYSICS
    simulated = np.asarray([reason in PHYSICS for reason in verdict.reason])
    assert np.isnan(verdict.hold_translation[~simulated]).all()
    assert np.isfinite(verdict.hold_translation[simulated]).all()


def test_a_hand_that_backs_off_loses_its_contacts(hand, grasps, grasped):
    away = np.stack([row.q for row in grasped])
    away[:, :3] += 0.5 * away[:, :3] / np.linalg.norm(away[:, :3], axis=1, keepdims=True)
    verdict = grasps(away)
    assert verdict.reason == ["no contact"] * len(away)
    assert np.isnan(verdict.hold_translation).all()
    assert np.isnan(verdict.hold_rotation).all()


def test_what_no_forces_can_squeeze_is_rejected_for_it(grasps, grasped, kept, phone):
    """Hands that touch one side only, judged as grasps, beside real ones."""
    verdict = grasps(np.concatenate([kept[0], np.stack([row.q for row in grasped])]))
    assert set(verdict.reason) <= GEOMETRY | PHYSICS | {""}
    # Where HiGHS finds forces that cancel, least squares finds some, too; where there are none, it may still come close to
    # balance, and physics decides.
    judged = [row for row, reason in enumerate(verdict.reason) if reason not in GEOMETRY]
    possible = [can_squeeze(verdict.contacts[row], phone.center_mass) for row in judged]
    reasons = [verdict.reason[row] for row in judged]
    assert "no squeeze" in reasons
    assert any(possible)
    for reason, can in zip(reasons, possible, strict=True):
        assert not (can and reason == "no squeeze")
    # Forces of one flat contact cannot cancel each other.
    for row in judged:
        if np.ptp(verdict.contacts[row].normals, axis=0).max() < 1e-3:
            assert verdict.reason[row] == "no squeeze"


def test_no_contact_holds_nothing(grasps, hand):
    far = np.zeros((1, 9 + hand.num_joints))
    far[0, :9] = [0.0, 0.0, 0.6, 1, 0, 0, 0, 1, 0]
    verdict = grasps(far)
    assert (verdict.reason, verdict.kept.tolist()) == (["no contact"], [False])
    assert verdict.columns(0)["contact_links"] == ()


def test_kept_again_with_the_same_margins(pushes, kept):
    q, margins = kept
    again = pushes(q)
    assert again.kept.all()
    np.testing.assert_allclose(again.direction_margin, margins, atol=2e-3)


def test_the_judge_agrees_along_the_best_direction_and_across_it(hand, phone, pushes, kept):
    q = kept[0][:6]
    verdict = pushes(q)
    for row in range(len(q)):
        best = best_direction(verdict.direction_margin[row])
        for index in (best, (best + 4) % NUM_DIRECTIONS):
            angle = direction_angles()[index]
            motion = np.asarray([np.cos(angle), np.sin(angle), 0.0])
            scene = replace(resting_scene(phone), motion=motion)
            judged = verify(scene, hand, q[row : row + 1])
            stored = verdict.direction_margin[row, index]
            assert judged.force_margin[0] == pytest.approx(max(stored, 0.0), abs=0.01)
            problem = balance_problem(verdict.contacts[row], support_contacts(scene), sliding_task(scene))
            balanced = solve_balance(problem, factor=1.0) is not None  # margins need not be monotone in the friction
            assert judged.success[0] == (stored >= 1.0 and balanced)
        assert judged.penetration_self[0] == pytest.approx(verdict.penetration[row, 2], abs=1e-6)


def test_deep_in_the_object_or_the_plane_is_rejected_for_it(pushes, kept, hand):
    q = kept[0][:1].repeat(2, axis=0)
    q[0, 2] -= 0.05
    q[1] = 0.0
    q[1, :9] = [0.0, 0.0, -0.1, 1, 0, 0, 0, 1, 0]
    verdict = pushes(q)
    assert all(reason.startswith("penetration") for reason in verdict.reason)
    assert verdict.reason[1] == "penetration environment"
    assert (verdict.direction_margin == -1.0).all()
    names = ("object", "environment", "self")
    assert verdict.reason[0] == f"penetration {names[int(verdict.penetration[0].argmax())]}"
    assert set(verdict.reason) <= GEOMETRY


def test_rows_do_not_depend_on_each_other(pushes, kept):
    together, alone = pushes(kept[0]), pushes(kept[0][2:3])
    np.testing.assert_array_equal(alone.penetration[0], together.penetration[2])
    np.testing.assert_allclose(alone.direction_margin[0], together.direction_margin[2], atol=1e-9)
    assert alone.columns(0)["contact_links"] == together.columns(2)["contact_links"]


def test_behaviours_by_where_the_hand_touches_and_comes_from():
    forward = np.full(NUM_DIRECTIONS, -1.0)
    forward[0] = 2.0  # moves along +x best
    top = patches(([0.0, 0.0, 0.005], [0.0, 0.0, 1.0]))
    back = patches(([-0.075, 0.0, 0.0], [-1.0, 0.0, 0.0]))
    assert behaviour_of(top, forward, np.asarray([-0.1, 0.0, 0.1]), NO_TURN) == "press"
    assert behaviour_of(back, forward, np.asarray([-0.1, 0.0, 0.1]), NO_TURN) == "push"
    assert behaviour_of(back, forward, np.asarray([0.1, 0.0, 0.1]), NO_TURN) == "hook"
    # As good along -x..+x by way of +y: the middle, +y, decides, not the first of them.
    half = np.full(NUM_DIRECTIONS, -1.0)
    half[: NUM_DIRECTIONS // 2 + 1] = 3.0
    assert behaviour_of(back, half, np.asarray([-0.1, 0.2, 0.1]), NO_TURN) == "hook"
    assert behaviour_of(back, half, np.asarray([0.1, -0.2, 0.1]), NO_TURN) == "push"


def test_no_support_in_free_space_and_a_plane_under_what_rests(phone):
    resting, floating = resting_scene(phone), floating_scene(phone)
    assert resting.environment_mesh.bounds[1, 2] == pytest.approx(phone.bounds[0, 2])
    assert floating.environment_mesh.bounds[1, 2] < phone.bounds[0, 2] - 1.0
