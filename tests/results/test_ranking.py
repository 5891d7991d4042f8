"""Margins along a push: what a closed form says of a block that is pressed from above and comes over an edge."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from dexnudge.mechanics.balance import balance_problem, problem_margin
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.sliding_task import GRAVITY, sliding_task
from dexnudge.planning import object_path
from dexnudge.planning.object_path import push_length
from dexnudge.results.path_margins import (
    careful_margins,
    find_stations,
    forward_offset,
    mean_help,
    path_margins,
    pressing_margins,
)
from dexnudge.results.ranking import ranking
from dexnudge.scenes.boxes import box
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts
from dexnudge.verification.verdicts import Verdicts

PENETRATIONS = ("penetration_object", "penetration_environment", "penetration_self")
LENGTH, HEIGHT = 0.15, 0.02  # [m] of the block, whose front end is flush with the table's edge at x = 0


@pytest.fixture(scope="module")
def at_the_edge() -> Scene:
    pose = np.eye(4)
    pose[:3, 3] = -LENGTH / 2, 0.0, HEIGHT / 2
    table = box((-0.5, -0.3, -0.04), (0.0, 0.3, 0.0))
    return Scene(trimesh.creation.box((LENGTH, 0.06, HEIGHT)), table, pose, np.array([1.0, 0.0, 0.0]))


def pressed_at(x: float) -> HandContacts:
    """Two links side by side on top of the block, x [m] from the edge."""
    points = np.array([[x, -0.02, HEIGHT], [x, 0.02, HEIGHT]])
    return HandContacts(points=points, normals=np.tile([0.0, 0.0, 1.0], (2, 1)), link=np.array([1, 2]))


def test_a_press_tips_the_block_once_it_is_too_far_beyond_the_edge(at_the_edge):
    # Pulled on top and held back below, the resultant at the support stands mu_e * HEIGHT ahead of the forces from above.
    # About the edge then N at `beyond` against the weight at `behind`; sliding needs N >= mu_e W / (mu_h - mu_e) = W.
    stations, ahead = np.array([0.0, 0.02, 0.04, 0.06]), 0.4 * HEIGHT
    for x in (-0.005, -0.02, -0.04, -0.06, -0.07):
        (margins,) = path_margins(at_the_edge, [pressed_at(x)], length=0.06)
        beyond, behind = x + stations + ahead, LENGTH / 2 - stations - ahead
        np.testing.assert_array_equal(margins >= 1.0, (beyond <= 0) | (behind >= beyond))


def test_a_press_in_the_middle_cannot_hold_a_block_whose_centre_is_beyond_the_edge(at_the_edge):
    assert path_margins(at_the_edge, [pressed_at(-LENGTH / 2)], length=0.09)[0, -1] == 0.0


def test_the_least_margin_prefers_the_press_that_stays_over_the_table(at_the_edge):
    tips, stays = pressing_margins(at_the_edge, [pressed_at(-0.005), pressed_at(-0.06)])
    assert tips < 1.0
    assert 1.0 <= stays <= 2.0


def test_what_ranking_needs_of_the_scene_alone_can_be_found_beforehand(at_the_edge, monkeypatch):
    scene, draws = replace(at_the_edge), [pressed_at(-0.06)]
    expected = path_margins(scene, draws, length=push_length(scene)), pressing_margins(scene, draws)
    find_stations(other := replace(at_the_edge))
    monkeypatch.setattr(object_path, "_slid", None)  # whatever carries it on its way is known
    monkeypatch.setattr(object_path, "plan_object_motion", None)
    found = path_margins(other, draws, length=push_length(other)), pressing_margins(other, draws)
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(found[1], expected[1])


def test_where_the_object_is_carried_alike_the_beginning_stands_for_the_way(at_the_edge):
    pose = np.eye(4)
    pose[:3, 3] = -0.3, 0.0, HEIGHT / 2
    scene = Scene(at_the_edge.object_mesh, at_the_edge.environment_mesh, pose, at_the_edge.motion)
    (margins,) = path_margins(scene, [pressed_at(-0.3)], length=scene.motion_length)
    np.testing.assert_allclose(margins, margins[0], atol=2e-3)
    assert pressing_margins(scene, [pressed_at(-0.3)]) == margins[0]


def touching(centre, *pairs):
    """A link each, at so many metres in front of the centre of mass, on both sides of it in turn, with its normal."""
    places, normals = zip(*pairs, strict=True)
    points = centre + np.array([[place, 0.01 * (-1) ** i, 0.0] for i, place in enumerate(places)])
    return HandContacts(points=points, normals=np.array(normals, dtype=float), link=np.arange(len(pairs)))


UP, BEHIND, SIDE, OTHER_SIDE, FRONT = np.array([[0, 0, 1], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0.8, 0, -0.6]], float)


def test_contacts_that_squeeze_or_hold_back_do_not_count(at_the_edge):
    centre = sliding_task(at_the_edge).centre
    press = (-0.02, UP), (0.0, UP)
    alone, helped, squeezing = pressing_margins(
        at_the_edge,
        [
            touching(centre, *press),
            touching(centre, *press, (0.01, SIDE), (0.01, OTHER_SIDE), (0.07, FRONT)),
            touching(centre, (0.0, SIDE), (0.0, OTHER_SIDE)),
        ],
    )
    assert alone == helped > 1.0
    assert squeezing == 0.0
    assert pressing_margins(at_the_edge, [touching(centre, (-0.075, BEHIND), (-0.075, BEHIND))])[0] > 1.5


NOBODY = HandContacts(points=np.zeros((0, 3)), normals=np.zeros((0, 3)), link=np.zeros(0, dtype=np.int64))


def test_the_lead_is_the_mean_over_all_contacts(at_the_edge):
    centre = sliding_task(at_the_edge).centre
    found = forward_offset(
        at_the_edge, [touching(centre, (0.05, UP), (0.02, SIDE)), touching(centre, (-0.06, BEHIND)), NOBODY]
    )
    np.testing.assert_allclose(found, [0.035, 0.0, np.inf])


def test_contacts_that_squeeze_or_hold_back_help_less(at_the_edge):
    slanted = np.array([0.0, 0.6, 0.8])
    hands = [[UP], [UP, BEHIND, slanted], [UP, SIDE], [UP, FRONT]]
    found = mean_help(at_the_edge, [touching(0.0, *((0.0, normal) for normal in hand)) for hand in hands] + [NOBODY])
    np.testing.assert_allclose(found, [1.0, 2.8 / 3, 0.5, 0.2, -1.0])


def test_a_margin_along_the_way_is_that_of_a_scene_made_for_that_place(at_the_edge):
    contacts, length = pressed_at(-0.05), 0.06
    (along,) = path_margins(at_the_edge, [contacts], length=length)
    for station, margin in enumerate(along):
        way = station / (len(along) - 1) * length
        pose = np.array(at_the_edge.T_world_object)
        pose[0, 3] += way
        there = replace(at_the_edge, T_world_object=pose)
        carried = replace(contacts, points=contacts.points + np.array([way, 0.0, 0.0]))
        assert problem_margin(balance_problem(carried, support_contacts(there), sliding_task(there))) == pytest.approx(
            margin, abs=2e-3
        )
    np.testing.assert_array_equal(path_margins(at_the_edge, [contacts], length=length)[0], along)


def judged(hands: list[HandContacts], margin: np.ndarray, *, success: np.ndarray) -> Verdicts:
    none = np.zeros(len(hands))
    return Verdicts(
        success=success,
        values={"force_margin": margin, **dict.fromkeys(PENETRATIONS, none)},
        contacts=hands,
        contact_links=[["a", "b"]] * len(hands),
        reasons=["" if ok else "contact" for ok in success],
    )


def test_the_order_of_draws_is_that_of_its_keys(at_the_edge, boxy_hand):
    # What presses at -0.06 or behind stays over the table all along the way; what presses at -0.005 tips the block.
    centre = float(sliding_task(at_the_edge).centre[0])
    squeezing = HandContacts(
        points=np.array([[-0.07, side * 0.03, HEIGHT / 2] for side in (-1.0, 1.0)]),
        normals=np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]),
        link=np.array([1, 2]),
    )
    hands = [
        pressed_at(-0.06),
        pressed_at(centre),
        squeezing,
        pressed_at(-0.005),
        pressed_at(centre),
        pressed_at(centre),
    ]
    margin = np.array([2.0, 1.6, 3.0, 2.0, 1.4, 3.0])
    verdicts = judged(hands, margin, success=np.array([True, True, True, True, True, False]))
    # at the centre; in front of it; tips on the way; squeezing, which presses nowhere; not robust; not verified
    assert ranking(at_the_edge, verdicts, boxy_hand, np.zeros((6, 13))).order.tolist() == [1, 0, 3, 2, 4, 5]
    # An object that turns is turned by what has the larger margin, a squeeze above all.
    turning = replace(at_the_edge, turn=Turn(0.5, np.array([0.0, 0.0, 1.0]), sliding_task(at_the_edge).centre))
    assert ranking(turning, verdicts, boxy_hand, np.zeros((6, 13))).order.tolist()[0] == 2


DEPTH, HEAVY, LIMIT, SMOOTH = 0.06, 3.0, 1.6, 0.1  # [m], [kg], [N] of a link, friction of the table


@pytest.fixture(scope="module")
def turning(at_the_edge) -> Scene:
    """The block in the middle of the table, to be turned in place."""
    pose = np.eye(4)
    pose[:3, 3] = -0.25, 0.0, HEIGHT / 2
    return replace(
        at_the_edge,
        T_world_object=pose,
        turn=Turn(0.5, np.array([0.0, 0.0, 1.0]), pose[:3, 3]),
        motion_length=0.0,
        mass=HEAVY,
        friction_environment=SMOOTH,
        max_normal_force=LIMIT,
    )


def couple(scene: Scene, *contacts: tuple[float, np.ndarray]) -> HandContacts:
    """A link at the block's right side and one at its left, opposite: contacts so far before and behind the centre."""
    before = np.array([[place, -DEPTH / 2, 0.0] for place, _ in contacts])
    normals = np.array([normal for _, normal in contacts])
    around = np.array([-1.0, -1.0, 1.0])
    return HandContacts(
        points=scene.T_world_object[:3, 3] + np.concatenate([before, around * before]),
        normals=np.concatenate([normals, around * normals]),
        link=np.repeat([1, 2], len(contacts)),
    )


def couples(scene: Scene) -> list[HandContacts]:
    """Around two edges of the block, where a link has the longest lever; and on its faces, a little nearer to its centre."""
    end = LENGTH / 2
    return [
        couple(scene, (end, OTHER_SIDE), (end, np.array([1.0, 0.0, 0.0]))),
        couple(scene, (end - 0.015, OTHER_SIDE), (end - 0.005, OTHER_SIDE)),
    ]


def of_couple(lever: float) -> float:
    """The margin of two links with so much moment about the centre per newton of press: all corners drag at one radius."""
    return 2 * LIMIT * lever / (SMOOTH * HEAVY * GRAVITY * np.hypot(LENGTH, DEPTH) / 2)


def test_careful_margins_are_those_of_blunt_contacts_with_less_friction(turning):
    # On a face, the outermost of the contacts presses: at 70 mm, or at 65 + 0.2 x 5 mm; friction's lever is half the depth.
    # Around an edge, the contact on the side is as good as one on a face; their mean presses along the diagonal.
    around_edges, on_faces = path_margins(turning, couples(turning), length=0.0)[:, 0]
    friction, end, side = turning.friction_hand, LENGTH / 2, DEPTH / 2
    assert around_edges == pytest.approx(of_couple(end + side * friction), abs=4e-3)
    assert on_faces == pytest.approx(of_couple(end - 0.005 + side * friction), abs=4e-3)
    less = 0.625 * friction  # the mean of 75 and 50 %
    found = careful_margins(turning, couples(turning))
    diagonal = (end - side + (end + side) * less) / np.sqrt(2.0)
    np.testing.assert_allclose(found, [of_couple(diagonal), of_couple(end - 0.009 + side * less)], atol=4e-3)


@pytest.fixture(scope="module")
def tipped() -> Scene:
    """A board on its end, 6 mm thick, tipped by 15 degrees over its front, at x = 0, then pulled by 5 cm."""
    pose = np.eye(4)
    pose[:3, 3] = -0.04, 0.0, 0.06
    turn = Turn(np.radians(15.0), np.array([0.0, 1.0, 0.0]), np.zeros(3))
    board, table = trimesh.creation.box((0.08, 0.006, 0.12)), box((-0.5, -0.3, -0.04), (0.5, 0.3, 0.0))
    forward = np.array([1.0, 0.0, 0.0])
    return Scene(board, table, pose, forward, motion_length=0.05, turn=turn, max_normal_force=3.0)


def pinches(*places: tuple[float, float]) -> HandContacts:
    """Links that touch the board's sides, 10 mm below its top: x [m] and the side of each."""
    points = np.array([[x, 0.003 * side, 0.11] for x, side in places])
    return HandContacts(points=points, normals=np.sign(points) * [0.0, 1.0, 0.0], link=np.arange(len(places)))


def test_careful_margins_of_what_is_pulled_upright_are_also_those_of_weights_that_lean(tipped):
    hands = [pinches((-0.03, 1), (-0.03, -1)), pinches((-0.01, 1), (-0.05, 1), (-0.03, -1), (-0.07, -1))]
    motion, found = tipped.object_motion, []
    for share in (0.75, 0.5):
        for lean in np.radians([-5.0, 0.0, 5.0]):
            load, margins = np.array([0.0, np.sin(lean), -np.cos(lean), 0.0, 0.0, 0.0]), []
            for way in (*motion.beginnings, motion.length):
                there = replace(tipped.carried(way), friction_hand=share * tipped.friction_hand)
                carried = [each.moved(motion.displacement(way)) for each in hands]
                problems = [balance_problem(each, support_contacts(there), sliding_task(there)) for each in carried]
                margins.append([problem_margin(replace(each, load=load)) for each in problems])
            found.append(np.min(margins, axis=0))
    pair, four = np.mean(found, axis=0)
    np.testing.assert_allclose(careful_margins(tipped, hands), [pair, four], atol=4e-3)
    assert found[4][0] > 2.9 > 1.0 > found[3][0], "upright the pair holds it with half its friction"
    assert four > pair + 0.5


def test_fingers_before_and_behind_do_not_count_where_the_object_is_pulled_upright(tipped):
    pair, more = pinches((-0.03, 1), (-0.03, -1)), pinches((-0.03, 1), (-0.03, -1), (0.0, 1), (-0.08, -1))
    more.normals[2:] = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]
    without, found = careful_margins(tipped, [pair, more])
    assert found == without


def test_what_stands_beside_an_object_is_not_counted_on_where_it_is_pulled_out(tipped):
    beside = box((-0.09, 0.0035, 0.0), (0.0, 0.03, 0.1))
    between = replace(tipped, environment_mesh=trimesh.util.concatenate([tipped.environment_mesh, beside]))
    assert (support_contacts(between).normals[:, 1] < -0.9).any()
    hands = [pinches((-0.03, 1), (-0.03, -1)), pinches((-0.03, -1))]
    np.testing.assert_allclose(careful_margins(between, hands), careful_margins(tipped, hands), atol=1e-6)
    assert careful_margins(between, hands)[1] == 0.0


def test_what_needs_an_edge_ranks_behind_what_presses_on_faces_only_where_the_object_turns(turning, boxy_hand):
    hands, q = couples(turning), np.zeros((2, 13))
    margin = path_margins(turning, hands, length=0.0)[:, 0]
    verdicts = judged(hands, margin, success=np.ones(2, dtype=bool))
    assert 1.0 < margin[1] < margin[0] < 1.5
    assert ranking(turning, verdicts, boxy_hand, q).order.tolist() == [1, 0]
    assert ranking(replace(turning, turn=None, motion_length=0.1), verdicts, boxy_hand, q).order.tolist() == [0, 1]
