"""An episode goes on: a push in it is the push that `run_push` makes, and the next one begins where it ended."""

import numpy as np
import pytest

from dexnudge.scenes.boxes import box
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.drive import PHASES, push_drive
from dexnudge.simulation.episode import Episode
from dexnudge.simulation.hand_path import along_line
from dexnudge.simulation.push import run_push
from dexnudge.simulation.push_forces import PushForces
from dexnudge.simulation.push_model import PushModel, load_push_model, push_model_xml

X = np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def push(pad_hand, block) -> PushModel:
    slab = box((-0.3, -0.3, -0.06), (0.3, 0.3, float(block.bounds[0, 2])))
    scene = Scene(block, slab, np.eye(4), X)
    return load_push_model(push_model_xml(pad_hand, scene), pad_hand, scene)


@pytest.fixture
def idle(push) -> PushForces:
    """Nothing is pressed: the pads go along beside the block."""
    none = np.zeros(push.model.nu)
    return PushForces(
        force=np.zeros((1, 0, 3)),
        motor_torque=none[None],
        base_wrench=np.zeros((1, 6)),
        cone_share=np.ones(1),
        surplus=np.ones(1),
        closing=none,
        base_closing=np.zeros(3),
    )


def test_a_push_in_an_episode_is_the_push_alone_and_the_next_goes_on(push, pad_grasp, idle):
    q, _ = pad_grasp
    drive = push_drive(np.zeros(1), q[None], motion=X, length=0.02)
    alone = run_push(push, q, drive, idle)
    episode = Episode(push, q)
    episode.slide(drive, idle)
    trace = episode.trace
    np.testing.assert_array_equal(trace.qpos, alone.qpos)
    assert trace.phase.tolist() == [PHASES[phase] for phase in alone.phase]
    np.testing.assert_allclose(
        episode.told, q + np.concatenate([0.02 * X, np.zeros(8)]), atol=1e-6
    )  # the height follows
    episode.attempt = 2
    episode.slide(push_drive(np.zeros(1), episode.told[None], motion=X, length=0.02), idle)
    both = episode.trace
    count = len(trace.time)
    assert (np.diff(both.time) > 0).all()
    assert both.attempt.tolist() == [1] * count + [2] * (len(both.time) - count)
    np.testing.assert_allclose(both.qpos[count], both.qpos[count - 1], atol=1e-3)  # no jump
    assert episode.q[0] == pytest.approx(0.04, abs=1e-3)
    assert episode.q[0] == pytest.approx(both.base_pose[-1, 0])


def test_carrying_on_keeps_what_the_motors_are_told(push, pad_grasp, idle):
    q, _ = pad_grasp
    episode = Episode(push, q)
    episode.slide(push_drive(np.zeros(1), q[None], motion=X, length=0.01), idle)
    told = push.data.ctrl.copy()
    episode.carry_on(along_line(episode.told, 0.01 * X, speed=0.05), "push")
    fingers = np.setdiff1d(np.arange(push.model.nu), push.base_motor)
    np.testing.assert_array_equal(push.data.ctrl[fingers], told[fingers])
    np.testing.assert_allclose(episode.told[:3], q[:3] + 0.02 * X, atol=1e-6)
    assert episode.trace.phase[-1] == "push"


def test_a_simulation_out_of_hand_is_seen_and_stops(push, pad_grasp):
    q, _ = pad_grasp
    episode = Episode(push, q)
    episode.play(along_line(q, 0.01 * X, speed=0.05), "transit")
    records = len(episode.trace.time)
    push.data.qvel[0] = 1.0e4  # [m/s]
    episode.play(along_line(episode.told, 0.01 * X, speed=0.05), "transit")
    assert episode.diverged
    episode.play(along_line(episode.told, 0.01 * X, speed=0.05), "transit")
    assert len(episode.trace.time) == records
    assert np.isfinite(episode.last_state).all()
