"""A block pinched between two pads and lifted: Coulomb's law says when it comes up, gravity what the pads carry."""

from dataclasses import replace

import numpy as np
import pytest

from dexnudge.hands.motors import JOINT_EFFORT
from dexnudge.mechanics.sliding_task import GRAVITY
from dexnudge.planning.outcomes import Outcome
from dexnudge.simulation.hand_path import along_line, waiting
from dexnudge.simulation.hold import STRONGEST_LINK, LiftRehearsal, squeeze
from dexnudge.simulation.model import scene_model
from dexnudge.simulation.rollout import Rollout, Trace
from dexnudge.simulation.success import judge_lift

MASS = 0.15  # [kg]
HEIGHT = 0.1  # [m] of the lift
LEVER = 0.5  # [m] of the pads, see pad_hand


def lifted(pad_hand, pad_grasp, block_scene, *, friction: float) -> tuple[Rollout, float]:
    """The rollout after closing, lifting and holding, and the sum of the normal forces that were wanted [N]."""
    q, contacts = pad_grasp
    simulation = scene_model(pad_hand, replace(block_scene, mass=MASS, friction_hand=friction))
    rollout = Rollout(simulation, q)
    rollout.follow(waiting(q, seconds=0.1), "reach")
    with rollout.elsewhere():
        simulation.place(q)
        force, motor_torque = squeeze(simulation, contacts, half_length=0.03, friction=0.6)
    rollout.close(motor_torque, "close")
    rollout.follow(along_line(rollout.commanded, np.array([0.0, 0.0, HEIGHT]), speed=0.1), "lift")
    rollout.follow(waiting(rollout.commanded, seconds=0.5), "hold")
    return rollout, float(-(force * contacts.normals).sum())


@pytest.fixture(scope="module")
def firm(pad_hand, pad_grasp, block_scene) -> tuple[Rollout, float]:
    """Two pads with 7.9 N in all carry up to 0.25 * 7.9 N = 2.0 N, more than the weight of 1.47 N."""
    return lifted(pad_hand, pad_grasp, block_scene, friction=0.25)


def test_a_firm_grasp_lifts_and_holds(firm):
    rollout, _ = firm
    verdict = judge_lift(rollout.trace, attempt=1, height=HEIGHT)
    assert (verdict.phase, verdict.outcome) == ("", Outcome.SUCCESS)
    assert rollout.T_world_object[2, 3] == pytest.approx(HEIGHT, abs=0.005)
    free = rollout.simulation.object_position
    rise = rollout.trace.qpos[-1, free + 2] - rollout.trace.qpos[0, free + 2]
    assert verdict.raised == pytest.approx(rise, abs=0.002)
    assert verdict.turned_deg < 2


def test_the_table_carries_the_weight_before_and_the_pads_afterwards(firm):
    rollout, wanted = firm
    trace = rollout.trace
    before, held = trace.phase == "reach", trace.phase == "hold"
    assert trace.support_force[before][-1] == pytest.approx(MASS * GRAVITY, rel=0.02)
    assert trace.support_force[held].max() == 0.0
    normal, tangential = trace.hand_object_force[held][-1]
    assert tangential == pytest.approx(MASS * GRAVITY, rel=0.05)  # friction at both pads is all that holds the block
    assert normal == pytest.approx(2 * JOINT_EFFORT / LEVER, rel=0.05)  # the motors' limit, below what was wanted
    assert normal < wanted <= 2 * STRONGEST_LINK + 1e-9


def test_a_slippery_grasp_leaves_the_block_where_it_is(pad_hand, pad_grasp, block_scene):
    rollout, _ = lifted(pad_hand, pad_grasp, block_scene, friction=0.08)  # 0.6 N of friction for a weight of 1.47 N
    verdict = judge_lift(rollout.trace, attempt=1, height=HEIGHT)
    assert (verdict.phase, verdict.outcome) == ("lift", Outcome.SLIPPED)
    assert verdict.raised < 0.08


def test_a_rehearsal_tells_a_grasp_that_will_hold_from_one_that_will_not(pad_hand, pad_grasp, block_scene):
    q, contacts = pad_grasp
    drifts = []
    # The pads' 8 N carry 0.75 * 0.8 * 8 N = 4.8 N; 1.25 times these masses weigh 1.2 N and 18 N.
    for mass in (0.1, 1.5):
        scene = replace(block_scene, mass=mass)
        rehearsal = LiftRehearsal(scene_model(pad_hand, scene), scene)
        drifts.append([rehearsal(q, contacts, np.eye(4)) for _ in range(2)])
    assert drifts[0][0] < 0.2
    assert drifts[1][0] > 1.0
    assert drifts[0][0] == drifts[0][1]  # what was rehearsed before changes nothing


def made_up(*, lifted=0.1, held=0.1, carried=0.0, depth=0.0, attempt=2) -> Trace:
    """An object at 0.5 m that is reached for, lifted and held; of the second attempt."""
    phase = np.array(["push", "reach", "close", "lift", "lift", "hold", "hold"])
    z = 0.5 + np.array([0.0, 0.0, 0.0, lifted / 2, lifted, lifted, held])
    count = len(phase)
    pose = np.zeros((count, 7))
    pose[:, 2], pose[:, 3] = z, 1.0
    pose[-1, 3:] = np.cos(np.radians(10)), 0.0, np.sin(np.radians(10)), 0.0  # turned by 20 degrees
    deep = np.full(count, 0.0)
    deep[-2], deep[0] = depth, 0.01  # what happened before it was reached for does not count here
    forces = np.array([1.4, 1.4, 1.0, 0.0, 0.0, 0.0, carried])
    nothing = np.zeros((count, 1))
    return Trace(
        time=np.arange(count) * 0.02,
        phase=phase,
        attempt=np.full(count, attempt),
        qpos=nothing,
        ctrl=nothing,
        mocap=np.zeros((count, 7)),
        object_pose=pose,
        hand_object_force=np.zeros((count, 2)),
        link_force=np.full((count, 2), [1.0, 3.0]),
        motor_force=nothing,
        torque_share=nothing,
        base_wrench=np.zeros((count, 6)),
        hand_environment_clearance=np.zeros(count),
        hand_environment_depth=deep,
        support_force=forces,
    )


def test_lifted_and_held():
    verdict = judge_lift(made_up(), attempt=2, height=0.1)
    assert (verdict.phase, verdict.outcome) == ("", Outcome.SUCCESS)
    assert verdict.raised == pytest.approx(0.1)
    assert verdict.least_held == pytest.approx(0.1)
    assert verdict.turned_deg == pytest.approx(20.0)
    assert verdict.hand_environment == 0.0
    assert verdict.link_force == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("changes", "phase", "outcome"),
    [
        ({"lifted": 0.03, "held": 0.0}, "lift", Outcome.SLIPPED),
        ({"held": 0.02}, "hold", Outcome.SANK),
        ({"carried": 0.1}, "hold", Outcome.STILL_CARRIED),
        ({"depth": 0.003}, "lift", Outcome.HAND_IN_ENVIRONMENT),
    ],
)
def test_what_goes_wrong_is_named(changes, phase, outcome):
    verdict = judge_lift(made_up(**changes), attempt=2, height=0.1)
    assert (verdict.phase, verdict.outcome) == (phase, outcome)
