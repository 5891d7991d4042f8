"""A rollout goes on: each act begins where the one before ended, and what is lent or out of hand is seen."""

import numpy as np
import pytest

from dexnudge.scenes.motion import Motion
from dexnudge.simulation.hand_path import PHASES, along_line, push_path
from dexnudge.simulation.model import SimulationModel, changed_physics, scene_model
from dexnudge.simulation.push_forces import PushForces
from dexnudge.simulation.rollout import Rollout

X = np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def simulation(pad_hand, block_scene) -> SimulationModel:
    return scene_model(pad_hand, block_scene)


@pytest.fixture
def idle(simulation) -> PushForces:
    """Nothing is pressed: the pads go along beside the block."""
    none = np.zeros(simulation.model.nu)
    return PushForces(
        done=np.zeros(1),
        force=np.zeros((1, 0, 3)),
        motor_torque=none[None],
        base_wrench=np.zeros((1, 6)),
        cone_share=np.ones(1),
        surplus=np.ones(1),
        closing=none,
        base_closing=np.zeros(3),
        link_force=np.zeros((1, 3)),
        link_torque=np.zeros((3, simulation.model.nu)),
        link_wrench=np.zeros((3, 6)),
        limit=5.0,
    )


def test_finer_steps_are_given_the_same_commands(simulation, pad_grasp):
    """Half the step: twice the steps, the same time and way, forces that differ by as little as integration does."""
    q, _ = pad_grasp
    finer, traces = changed_physics(simulation), []
    finer.model.opt.timestep /= 2
    for model in (simulation, finer):
        rollout = Rollout(model, q)
        rollout.follow(along_line(q, 0.02 * X, speed=0.1), "away")
        traces.append(rollout.trace)
    coarse, fine = traces
    np.testing.assert_allclose(fine.time, coarse.time, atol=1e-9)
    np.testing.assert_array_equal(fine.mocap, coarse.mocap)
    np.testing.assert_allclose(fine.qpos, coarse.qpos, atol=5e-4)  # the pads swing by 0.5 mrad as they set off


def test_a_second_push_goes_on_where_the_first_ended(simulation, pad_grasp, idle):
    q, _ = pad_grasp
    rollout = Rollout(simulation, q)
    rollout.push(push_path(np.zeros(1), q[None], motion=Motion(None, X, 0.02), length=0.02), idle)
    first = rollout.trace
    assert list(dict.fromkeys(first.phase)) == [phase for phase in PHASES if phase != "approach"]
    expected = q + np.concatenate([0.02 * X, np.zeros(8)])
    np.testing.assert_allclose(rollout.commanded, expected, atol=1e-6)  # the height follows
    rollout.attempt = 2
    rollout.push(push_path(np.zeros(1), rollout.commanded[None], motion=Motion(None, X, 0.02), length=0.02), idle)
    both = rollout.trace
    count = len(first.time)
    assert (np.diff(both.time) > 0).all()
    assert both.attempt.tolist() == [1] * count + [2] * (len(both.time) - count)
    np.testing.assert_allclose(both.qpos[count], both.qpos[count - 1], atol=1e-3)  # no jump
    assert rollout.q[0] == pytest.approx(0.04, abs=1e-3)
    assert rollout.q[0] == pytest.approx(both.qpos[-1, simulation.palm_position])


def test_a_simulation_out_of_hand_is_seen_and_stops(simulation, pad_grasp):
    q, _ = pad_grasp
    rollout = Rollout(simulation, q)
    rollout.follow(along_line(q, 0.01 * X, speed=0.05), "transit")
    records, steps = len(rollout.trace.time), round(simulation.data.time / simulation.model.opt.timestep)
    simulation.data.qvel[0] = 1.0e4  # [m/s]
    rollout.follow(along_line(rollout.commanded, 0.01 * X, speed=0.05), "transit")
    assert rollout.divergence.step == rollout.divergence.last_step == steps
    assert np.isfinite(rollout.divergence.state).all()
    rollout.follow(along_line(rollout.commanded, 0.01 * X, speed=0.05), "transit")
    assert len(rollout.trace.time) == records


def test_what_is_lent_in_between_changes_nothing(simulation, pad_grasp):
    q, _ = pad_grasp
    ends = []
    for lent in (False, True):
        rollout = Rollout(simulation, q)
        rollout.follow(along_line(q, np.array([0.0, 0.0, 0.02]), speed=0.1), "lift")
        if lent:
            with rollout.elsewhere():
                simulation.place(q + 0.001)
        rollout.follow(along_line(rollout.commanded, np.array([0.02, 0.0, 0.0]), speed=0.1), "lift")
        ends.append(rollout.trace.qpos)
    np.testing.assert_array_equal(ends[0], ends[1])
