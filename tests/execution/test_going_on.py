"""A push that falls short goes on from where the object lies, with what fits there."""

from dataclasses import replace

import numpy as np
import pytest

from dexnudge.execution import executor as executor_module
from dexnudge.execution import slide_grasp_lift
from dexnudge.execution.executor import Executor
from dexnudge.execution.scene_rollout import SceneRollout
from dexnudge.execution.slide_grasp_lift import MOST_PLANNED, MOST_REGRASPS, Slide
from dexnudge.planning.approach import Approach
from dexnudge.planning.hand_clearance import Blocked
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.uncertainty import Uncertainty
from dexnudge.simulation.model import scene_model
from dexnudge.simulation.open_loop import OpenLoop
from dexnudge.simulation.push_forces import forces_with_reserve
from dexnudge.simulation.rollout import Rollout

LENGTH, STRIDE = 0.06, 0.025  # [m]


class Stride(OpenLoop):
    """Ends every push once the object has come so far."""

    def start(self, plan):
        super().start(plan)
        self._begun = None

    def command(self, seen):
        if self._begun is None:
            self._begun = seen.T_world_object[0, 3]
        return None if seen.T_world_object[0, 3] > self._begun + STRIDE else super().command(seen)


class Stopped(Rollout):
    """One in which the object is where it is said to be."""

    T_world_object = None

    def __init__(self, T_world_object):
        self.T_world_object = T_world_object


@pytest.fixture(scope="module")
def executor(pad_hand, block_scene):
    scene = replace(block_scene, motion_length=LENGTH)
    return Executor(scene, scene_model(pad_hand, scene), Stride())


def test_a_push_that_falls_short_goes_on(executor, pad_grasp):
    q, _ = pad_grasp
    once = executor(q)
    assert isinstance(once.approach, Approach)
    assert once.verdict.outcome is Outcome.FELL_SHORT
    assert once.verdict.length_reached == pytest.approx(STRIDE, abs=0.002)
    assert set(once.trace.attempt) == {1}
    on = executor(q, q[None][:0])  # no others: with the same one, carried along
    assert on.verdict.success
    assert on.verdict.length_reached > 0.8 * LENGTH
    assert set(on.trace.attempt) == {1, 2}
    assert set(on.trace.attempt) <= set(range(1, 2 + MOST_REGRASPS))
    assert on.trace.phase[-1] != "release"  # a hand that is there does not let go
    count = len(once.trace.time)
    np.testing.assert_array_equal(on.trace.qpos[:count], once.trace.qpos)


def test_what_no_longer_fits_takes_no_place_of_what_does(executor, pad_grasp, monkeypatch):
    q, _ = pad_grasp
    aside = np.tile(q, (MOST_PLANNED, 1))
    aside[:, 1] += 0.003  # one pad in the object
    monkeypatch.setattr(Slide, "_least_margins", lambda *given: given[-1][:, 1])  # these seem to balance best
    on = executor(q, aside)
    assert on.verdict.success
    assert set(on.trace.attempt) == {1, 2}


def test_later_holds_too_are_planned_for_the_hardest_world(pad_hand, block_scene, pad_grasp, monkeypatch):
    scene = replace(block_scene, motion_length=LENGTH, uncertainty=Uncertainty(friction=(0.8, 1.0), mass=(1.0, 1.5)))
    planned = []

    def noted(simulation, q, contacts, stations, task):
        planned.append(task)
        return forces_with_reserve(simulation, q, contacts, stations, task)

    for module in (executor_module, slide_grasp_lift):
        monkeypatch.setattr(module, "forces_with_reserve", noted)
    q, _ = pad_grasp
    Executor(scene, scene_model(pad_hand, scene), Stride())(q, q[None][:0])
    assert len(planned) > 1
    for task in planned:
        assert task.friction_hand == pytest.approx(0.8 * scene.friction_hand)
        assert task.mass == pytest.approx(1.5 * scene.mass)


@pytest.mark.parametrize("slide_length", [0.0, LENGTH])
def test_what_is_left_of_a_motion_that_turns_is_its_length_less_what_is_made(pad_hand, block_scene, slide_length):
    turn = Turn(0.5, np.array([0.0, 0.0, 1.0]), np.add(block_scene.centre_of_mass, [0.01, 0.02, 0.0]))
    scene = replace(block_scene, turn=turn, motion_length=slide_length)
    length, turn_length = scene.object_motion.length, scene.object_motion.turn_length
    executor = Executor(scene, scene_model(pad_hand, scene))
    for way in np.linspace(0.0, 0.99 * length, 7):
        there = scene.carried(float(way))
        assert executor._left(there) == pytest.approx(length - way)
        assert executor._there(there) == (way >= (turn_length + 0.8 * slide_length if slide_length else 0.8 * length))
        stage = SceneRollout(scene, executor._simulation, Stopped(there.T_world_object))
        assert executor._left(stage.scene_now()) == pytest.approx(length - way, abs=0.2 * turn_length)
        assert executor._there(stage.scene_now()) == executor._there(there)


@pytest.mark.parametrize("number", [0, 2])
def test_a_push_begins_with_another_configuration_where_no_free_way_leads_to_its_own(executor, pad_grasp, number):
    q, _ = pad_grasp
    below = q.copy()
    below[2] -= 0.02  # in the table
    alone, instead = executor(below), executor(below, np.stack([below, q]))
    assert isinstance(alone.approach, Blocked)
    assert isinstance(instead.approach, Approach)
    assert (alone.began_with, instead.began_with) == (0, 2)
    listed = np.insert(np.array([1, 2]), number, 0)  # places of `below`, `below` again, and `q` in a caller's list
    assert listed[instead.number_of_first(number)] == 2
    np.testing.assert_array_equal(instead.trace.qpos[0], executor(q).trace.qpos[0])


@pytest.mark.parametrize("gives_up", [0, 1, 3])
def test_a_turn_begins_with_what_held_in_a_harder_world(pad_hand, block_scene, pad_grasp, monkeypatch, gives_up):
    q, _ = pad_grasp
    scene = replace(block_scene, motion_length=LENGTH)
    simulation, masses = scene_model(pad_hand, scene), []

    class Weighed(OpenLoop):
        """Gives up the first pushes; notes in which world each begins."""

        def command(self, seen):
            return None if len(masses) <= gives_up else super().command(seen)

    def noted(rollout, *given, **named):
        masses.append(rollout.simulation.model.body_mass[simulation.object_body])
        return push(rollout, *given, **named)

    push, forces = Rollout.push, executor_module.forces_with_reserve
    monkeypatch.setattr(Rollout, "push", noted)
    planned = []
    monkeypatch.setattr(executor_module, "forces_with_reserve", lambda *given: planned.append(given) or forces(*given))
    executor = Executor(scene, simulation, Weighed())
    assert not executor._rehearses  # it slides
    executor._rehearses = True
    found = executor(q, np.stack([q, q]))
    nominal = float(simulation.model.body_mass[simulation.object_body])
    rehearsed = min(gives_up + 1, 3)  # of three configurations
    np.testing.assert_allclose(masses[: rehearsed + 1], [1.15 * nominal] * rehearsed + [nominal])
    assert found.began_with == (gives_up if gives_up < 3 else 0)  # where none held, with the first
    assert found.failed_rehearsal == (gives_up > 0)
    assert found.verdict.success
    assert len(planned) == rehearsed  # once each
    masses.clear()
    alone = executor(q, q[None][:0])
    assert not alone.failed_rehearsal  # nothing to choose from
    stages = {"approach", "forces", "simulation"}
    assert (set(found.seconds), set(alone.seconds)) == (stages | {"rehearsal"}, stages)
    np.testing.assert_allclose(masses[0], nominal)
    turning = replace(scene, turn=Turn(0.5, np.array([0.0, 0.0, 1.0]), np.asarray(scene.centre_of_mass)))
    assert Executor(turning, simulation)._rehearses


def test_an_object_that_slid_too_far_and_turned_too_little_has_its_turn_left(pad_hand, block_scene):
    turn = Turn(0.5, np.array([0.0, 0.0, 1.0]), np.asarray(block_scene.centre_of_mass))
    scene = replace(block_scene, turn=turn, motion_length=LENGTH)
    executor = Executor(scene, scene_model(pad_hand, scene))
    T_world_object = np.array(scene.T_world_object)
    T_world_object[:3, 3] += 2 * scene.object_motion.length * scene.motion
    there = SceneRollout(scene, executor._simulation, Stopped(T_world_object)).scene_now()
    assert executor._left(there) == pytest.approx(scene.object_motion.turn_length)
    assert not executor._there(there)
