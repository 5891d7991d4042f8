"""What the page changes of a scene, against scenes that are made so from the start."""

from dataclasses import replace

import numpy as np
import pytest

import dexnudge as dn
from dexnudge.errors import SceneError
from dexnudge.studio.edits import Edits


@pytest.fixture(scope="module")
def table():
    return dn.build_scene("table", "phone", seed=0)


def test_without_changes_the_scene_stays_the_very_same(table):
    assert Edits.none(table).applied(table) is table


def test_frictions_alone_change_nothing_else(table):
    edits = Edits.none(table)
    found = replace(edits, numbers={**edits.numbers, "friction_hand": 0.5}).applied(table)
    assert (found.friction_hand, found.name, found.seed) == (0.5, table.name, table.seed)
    assert found.environment_mesh is table.environment_mesh


def test_a_heading_turns_the_motion_about_what_carries_the_object(table):
    found = replace(Edits.none(table), heading=90.0).applied(table)
    x, y, z = table.motion
    assert found.motion == pytest.approx([-y, x, z], abs=1e-9)


def test_an_object_that_was_lifted_by_a_millimetre_settles_again(table):
    moved = np.eye(4)
    moved[:3, 3] = [0.02, 0.01, 0.001]
    found = replace(Edits.none(table), moved=moved).applied(table)
    shift = found.T_world_object[:3, 3] - table.T_world_object[:3, 3]
    assert shift == pytest.approx([0.02, 0.01, 0.0], abs=1e-4)


def test_an_object_that_is_dragged_into_the_air_is_refused(table):
    moved = np.eye(4)
    moved[2, 3] = 0.1
    with pytest.raises(SceneError, match="expected"):
        replace(Edits.none(table), moved=moved).applied(table)


@pytest.mark.parametrize("degrees", [90.0, -45.0])
def test_a_turn_is_about_the_normal_in_preview_and_scene(table, degrees):
    edits = replace(Edits.none(table), turn=degrees)
    for scene in (edits.applied(table), edits.preview(table)):
        assert scene.turn.angle == pytest.approx(abs(np.radians(degrees)))
        assert scene.turn.axis == pytest.approx([0, 0, np.sign(degrees)], abs=1e-9)
        assert Edits.none(scene).turn == pytest.approx(degrees)


def test_a_tip_is_recognised_as_one():
    book = dn.build_scene("book", "book", seed=0)
    edits = Edits.none(book)
    assert edits.turn == 0.0
    assert edits.tip == pytest.approx(np.degrees(book.turn.angle))
    assert edits.applied(book) is book
