"""What is kept, against HiGHS, against the judge, and on hands whose verdict is plain."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from dexnudge.dataset.schema import NUM_DIRECTIONS, direction_angles
from dexnudge.evaluation.success import judge
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.friction_cone import friction_cone_edges, wrenches
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.synthesis.verification import (
    GraspVerifier,
    NonPrehensileVerifier,
    behaviour_of,
    floating_scene,
    resting_scene,
)

HALF_WIDTH = 0.036  # [m] of the built-in phone
ACCELERATION = 10.0  # [m/s^2] DexGraspBench's disturbance


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
    rows = [row for row in generated[0] if row.behaviour != "grasp"]
    return np.stack([row.q for row in rows]).astype(np.float64), np.stack([row.direction_margin for row in rows])


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


def holds_by_linear_programming(contacts: HandContacts, task) -> bool:
    """Whether forces within cones and limits balance the disturbance along each axis, by HiGHS, in newtons."""
    edges = friction_cone_edges(contacts.normals, task.motion, friction=task.friction_hand)
    columns = wrenches(contacts.points[:, None], edges, centre=task.centre, half_length=task.half_length)
    columns = columns.reshape(-1, 6).T
    owner = np.repeat(contacts.link, edges.shape[1])
    limits = (owner == np.unique(contacts.link)[:, None]).astype(float)
    for axis in np.concatenate([np.eye(3), -np.eye(3)]):
        load = np.concatenate([axis * ACCELERATION * task.mass, np.zeros(3)])
        cap = np.full(len(limits), task.max_normal_force)
        if linprog(np.ones(columns.shape[1]), A_ub=limits, b_ub=cap, A_eq=columns, b_eq=load).status != 0:
            return False
    return True


def test_a_pinch_holds_and_one_side_does_not(grasps):
    left, right = ([0.0, HALF_WIDTH, 0.0], [0.0, 1.0, 0.0]), ([0.0, -HALF_WIDTH, 0.0], [0.0, -1.0, 0.0])
    assert grasps._holds(patches(left, right))
    assert not grasps._holds(patches(left))
    assert not grasps._holds(patches(left, ([0.03, HALF_WIDTH, 0.0], [0.0, 1.0, 0.0])))


def test_holding_agrees_with_linear_programming(grasps, phone):
    task = sliding_task(floating_scene(phone))
    generator = np.random.default_rng(0)
    found, expected = [], []
    for _ in range(40):
        places = []
        for side in (1.0, -1.0, generator.choice([1.0, -1.0])):
            normal = np.asarray([generator.normal(0, 0.4), side, generator.normal(0, 0.4)])
            place = [generator.uniform(-0.05, 0.05), side * HALF_WIDTH, generator.uniform(-0.004, 0.004)]
            places.append((place, normal / np.linalg.norm(normal)))
        contacts = patches(*places, size=0.003)
        found.append(grasps._holds(contacts))
        expected.append(holds_by_linear_programming(contacts, task))
    assert 5 < sum(expected) < 35
    assert not (np.asarray(found) & ~np.asarray(expected)).any(), "what is kept must hold"
    # Least squares stops at any forces that balance; where these break a limit, others may keep it: some are lost.
    assert np.mean(np.asarray(found) == np.asarray(expected)) >= 0.75


def test_no_contact_holds_nothing(grasps, hand):
    far = np.zeros((1, 9 + hand.num_joints))
    far[0, :9] = [0.0, 0.0, 0.6, 1, 0, 0, 0, 1, 0]
    verdict = grasps(far)
    assert (verdict.reason, verdict.kept.tolist()) == (["no contact"], [False])
    assert verdict.contact_links(0) == ()


def test_kept_again_with_the_same_margins(pushes, kept):
    q, margins = kept
    again = pushes(q)
    assert again.kept.all()
    np.testing.assert_allclose(again.direction_margin, margins, atol=2e-3)


def test_the_judge_agrees_along_the_best_direction_and_across_it(hand, phone, pushes, kept):
    q = kept[0][:6]
    verdict = pushes(q)
    for row in range(len(q)):
        best = int(np.argmax(verdict.direction_margin[row]))
        for index in (best, (best + 4) % NUM_DIRECTIONS):
            angle = direction_angles()[index]
            motion = np.asarray([np.cos(angle), np.sin(angle), 0.0])
            judged = judge(hand, replace(resting_scene(phone), motion=motion), q[row : row + 1])
            stored = verdict.direction_margin[row, index]
            assert judged.force_margin[0] == pytest.approx(max(stored, 0.0), abs=0.01)
            assert judged.success[0] == (stored >= 1.0)
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


def test_rows_do_not_depend_on_each_other(pushes, kept):
    together, alone = pushes(kept[0]), pushes(kept[0][2:3])
    np.testing.assert_array_equal(alone.penetration[0], together.penetration[2])
    np.testing.assert_allclose(alone.direction_margin[0], together.direction_margin[2], atol=1e-9)
    assert alone.contact_links(0) == together.contact_links(2)


def test_behaviours_by_where_the_hand_touches_and_comes_from():
    forward = np.full(NUM_DIRECTIONS, -1.0)
    forward[0] = 2.0  # moves along +x best
    top = patches(([0.0, 0.0, 0.005], [0.0, 0.0, 1.0]))
    back = patches(([-0.075, 0.0, 0.0], [-1.0, 0.0, 0.0]))
    assert behaviour_of(top, forward, np.asarray([-0.1, 0.0, 0.1])) == "press"
    assert behaviour_of(back, forward, np.asarray([-0.1, 0.0, 0.1])) == "push"
    assert behaviour_of(back, forward, np.asarray([0.1, 0.0, 0.1])) == "hook"


def test_no_support_in_free_space_and_a_plane_under_what_rests(phone):
    resting, floating = resting_scene(phone), floating_scene(phone)
    assert resting.environment_mesh.bounds[1, 2] == pytest.approx(phone.bounds[0, 2])
    assert floating.environment_mesh.bounds[1, 2] < phone.bounds[0, 2] - 1.0
