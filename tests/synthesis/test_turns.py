"""Turns of an object at rest: their axes on a plain box, their margins against HiGHS, and objects that stand."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from dexnudge.dataset.manifest import read_manifest
from dexnudge.dataset.schema import INFEASIBLE, TURNS
from dexnudge.dataset.shards import column_matrix, read_shard, write_turns
from dexnudge.mechanics.balance import balance_problem, problem_margin
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.objects.builtin import builtin_object
from dexnudge.scenes.resting import standing_pose
from dexnudge.synthesis.acceptance import TABLE_EDGE, NonPrehensileVerifier, resting_scene, resting_turns
from dexnudge.synthesis.object_data import at_rest, generate_object, stands
from dexnudge.synthesis.recheck import check_dataset, label_turns

LENGTH, WIDTH, HEIGHT = 0.2, 0.1, 0.04  # [m]
PLACE = 2e-6  # [m, m/m] supports are found on points that are rounded to 1e-7 m


@pytest.fixture(scope="module")
def turns():
    return dict(zip(TURNS, resting_turns(resting_scene(trimesh.creation.box((LENGTH, WIDTH, HEIGHT)))), strict=True))


def test_a_box_turns_about_its_middle(turns):
    twist = turns["turn +z"].twist
    np.testing.assert_allclose(twist.angular, [0, 0, 2 / np.hypot(LENGTH, WIDTH)], atol=1e-9)
    np.testing.assert_allclose(twist.linear, 0, atol=1e-9)
    np.testing.assert_allclose(turns["turn -z"].twist.angular, -twist.angular)


@pytest.mark.parametrize(
    ("way", "side", "across"), [("+x", LENGTH, 0), ("-x", LENGTH, 0), ("+y", WIDTH, 1), ("-y", WIDTH, 1)]
)
def test_a_box_tips_over_its_edge(turns, way, side, across):
    """The edge stands, the far upper edge moves fastest, and the top moves the way that the tip heads."""
    sign = 1 if way[0] == "+" else -1
    tip = turns[f"tip {way}"]
    edge = np.array([0.0, 0.0, -HEIGHT / 2])
    edge[across] = sign * side / 2
    np.testing.assert_allclose(tip.twist.velocity(edge), 0, atol=PLACE)
    far = -edge
    assert np.linalg.norm(tip.twist.velocity(far)) == pytest.approx(1.0, abs=PLACE)
    assert tip.twist.velocity(np.array([0, 0, HEIGHT / 2]))[across] * sign > 0
    assert (tip.twist.velocity(tip.supports.points)[:, 2] > -PLACE).all()  # nothing is pressed into the plane


def test_on_a_table_s_edge_only_the_table_carries(turns):
    edge = turns["edge +x"]
    place = TABLE_EDGE * LENGTH / 2
    assert edge.supports.points[:, 0].max() == pytest.approx(place, abs=PLACE)
    np.testing.assert_allclose(edge.twist.velocity(np.array([place, 0.0, -HEIGHT / 2])), 0, atol=PLACE)
    assert edge.twist.velocity(np.array([LENGTH / 2, 0, -HEIGHT / 2]))[2] < 0  # what reaches over it goes down


@pytest.mark.slow
@pytest.mark.parametrize(("name", "upright"), [("phone", False), ("book", True)])
def test_margins_of_rows_against_highs(hand, name, upright):
    mesh = builtin_object(name)
    made = generate_object(
        hand, mesh, non_prehensile=16, grasps=0, generator=np.random.default_rng(3), seed=0, upright=upright
    )
    scene = resting_scene(at_rest(mesh, upright=upright))
    verifier, task = NonPrehensileVerifier(hand, scene), sliding_task(scene)
    found = verifier(np.stack([row.q for row in made.rows]))
    judged = 0
    for row, contacts in zip(made.rows, found.contacts, strict=True):
        for index, turn in enumerate(resting_turns(scene)):
            if turn is None:
                assert row.turn_margin[index] == INFEASIBLE
                continue
            margin = problem_margin(balance_problem(contacts, turn.supports, task.moving(turn.twist)))
            assert row.turn_margin[index] == pytest.approx(margin if margin > 0 else INFEASIBLE, abs=2e-3)
            judged += margin >= 1
    assert judged > len(made.rows)  # more than one each


@pytest.mark.parametrize("name", ["book", "box", "tablet"])
def test_standing_objects_have_their_longest_side_up(name):
    mesh = builtin_object(name)
    standing = at_rest(mesh, upright=True)
    assert standing.extents[2] == pytest.approx(max(mesh.extents), rel=1e-3)
    assert standing.extents[0] >= standing.extents[1]
    np.testing.assert_allclose(sorted(standing.extents), sorted(at_rest(mesh).extents), rtol=1e-3)
    assert standing.volume == pytest.approx(mesh.volume)  # turned, not mirrored


def test_what_cannot_stand_lies():
    spindle = trimesh.creation.revolve([[0.0, -0.06], [0.03, 0.0], [0.0, 0.06]])  # a point at either end
    assert standing_pose(spindle) is None
    np.testing.assert_allclose(at_rest(spindle, upright=True).extents, at_rest(spindle).extents)


def test_a_share_of_the_objects_stands():
    names = [f"box-{number:03d}" for number in range(400)]
    assert sum(stands(name, 0.25) for name in names) == pytest.approx(100, abs=35)  # four standard errors
    assert all(stands(name, 1.0) for name in names)
    assert not any(stands(name, 0.0) for name in names)


@pytest.mark.slow
def test_turns_judged_later_are_those_judged_at_once(copy, objects, files_of, names):
    """As in a dataset from before: the column and its twists are taken away, and come back to the byte."""
    made, manifest = files_of(copy), read_manifest(copy)
    for name in names:
        shard = read_shard(copy, manifest, name)
        empty = np.full((shard.table.num_rows, len(TURNS)), INFEASIBLE)
        write_turns(copy, manifest, shard, empty, np.full((len(TURNS), 6), np.nan))
    told = check_dataset(copy, objects=str(objects), workers=1).differences
    assert any("turn_margin" in lie for lie in told)
    assert any("turns[0]" in lie for lie in told)
    for name in names:
        shard = read_shard(copy, manifest, name)
        write_turns(copy, manifest, replace(shard, turns=None), empty_of(shard), None)
    assert check_dataset(copy, objects=str(objects), workers=1).differences == ()  # an old dataset is whole
    assert label_turns(copy, objects=str(objects), workers=1) == len(names)
    assert files_of(copy) == made
    assert column_matrix(read_shard(copy, manifest, names[0]).table, "turn_margin").max() >= 1.0


def empty_of(shard):
    return np.full((shard.table.num_rows, len(TURNS)), INFEASIBLE)
