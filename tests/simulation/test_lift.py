"""A block pinched between two pads and lifted: Coulomb's law says when it comes up, gravity what the pads carry."""

import numpy as np
import pytest

from dexnudge.hands.physical import JOINT_EFFORT
from dexnudge.mechanics.sliding_task import GRAVITY
from dexnudge.scenes.boxes import box
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.episode import Episode
from dexnudge.simulation.hand_path import along_line, waiting
from dexnudge.simulation.lift_verdict import judge_lift
from dexnudge.simulation.push_model import load_push_model, push_model_xml
from dexnudge.simulation.rehearsal import lift_rehearsal
from dexnudge.simulation.squeeze import STRONGEST_LINK, squeeze

MASS = 0.15  # [kg]
HEIGHT = 0.1  # [m] of the lift
LEVER = 0.5  # [m] of the pads, see pad_hand


def lifted(pad_hand, pad_grasp, block, *, friction: float) -> tuple[Episode, float]:
    """The episode after closing, lifting and holding, and the sum of the normal forces that were wanted [N]."""
    q, contacts = pad_grasp
    bottom = block.bounds[0, 2]
    slab = box((-0.3, -0.3, bottom - 0.04), (0.3, 0.3, bottom))
    scene = Scene(block, slab, np.eye(4), np.array([1.0, 0.0, 0.0]), mass=MASS, friction_hand=friction)
    push = load_push_model(push_model_xml(pad_hand, scene), pad_hand, scene)
    episode = Episode(push, q)
    episode.play(waiting(q, seconds=0.1), "reach")
    with episode.elsewhere():
        push.place(q)
        wanted = squeeze(push, contacts, half_length=0.03, friction=0.6)
    episode.close(wanted.motor_torque, "close", ramp=0.1, seconds=0.2)
    episode.play(waiting(episode.told, seconds=0.1), "close")
    episode.play(along_line(episode.told, np.array([0.0, 0.0, HEIGHT]), speed=0.1), "lift")
    episode.play(waiting(episode.told, seconds=0.5), "hold")
    return episode, float(-(wanted.force * contacts.normals).sum())


@pytest.fixture(scope="module")
def firm(pad_hand, pad_grasp, block) -> tuple[Episode, float]:
    """Two pads with 7.9 N in all carry up to 0.25 * 7.9 N = 2.0 N, more than the weight of 1.47 N."""
    return lifted(pad_hand, pad_grasp, block, friction=0.25)


def test_a_firm_grasp_lifts_and_holds(firm):
    episode, _ = firm
    verdict = judge_lift(episode.trace, attempt=1, height=HEIGHT)
    assert (verdict.phase, verdict.reason) == ("", "")
    assert episode.T_world_object[2, 3] == pytest.approx(HEIGHT, abs=0.005)
    free = episode.push.object_position
    rise = episode.trace.qpos[-1, free + 2] - episode.trace.qpos[0, free + 2]
    assert verdict.raised == pytest.approx(rise, abs=0.002)
    assert verdict.turned_deg < 2


def test_the_table_carries_the_weight_before_and_the_pads_afterwards(firm):
    episode, wanted = firm
    trace = episode.trace
    before, held = trace.phase == "reach", trace.phase == "hold"
    assert trace.carried[before][-1] == pytest.approx(MASS * GRAVITY, rel=0.02)
    assert trace.carried[held].max() == 0.0
    normal, tangential = trace.hand_object_force[held][-1]
    assert tangential == pytest.approx(MASS * GRAVITY, rel=0.05)  # friction at both pads is all that holds the block
    assert normal == pytest.approx(2 * JOINT_EFFORT / LEVER, rel=0.05)  # the motors' limit, below what was wanted
    assert normal < wanted <= 2 * STRONGEST_LINK + 1e-9


def test_a_slippery_grasp_leaves_the_block_where_it_is(pad_hand, pad_grasp, block):
    episode, _ = lifted(pad_hand, pad_grasp, block, friction=0.08)  # 0.6 N of friction for a weight of 1.47 N
    verdict = judge_lift(episode.trace, attempt=1, height=HEIGHT)
    assert verdict.phase == "lift"
    assert verdict.reason == f"slipped on lift: raised {1e3 * verdict.raised:.0f} of 100 mm"
    assert verdict.raised < 0.08


def test_looking_elsewhere_changes_nothing(pad_hand, pad_grasp, block):
    q, _ = pad_grasp
    slab = box((-0.3, -0.3, -0.06), (0.3, 0.3, block.bounds[0, 2]))
    scene = Scene(block, slab, np.eye(4), np.array([1.0, 0.0, 0.0]))
    xml = push_model_xml(pad_hand, scene)
    ends = []
    for looked in (False, True):
        episode = Episode(load_push_model(xml, pad_hand, scene), q)
        episode.play(along_line(q, np.array([0.0, 0.0, 0.02]), speed=0.1), "lift")
        if looked:
            with episode.elsewhere():
                episode.push.place(q + 0.001)
        episode.play(along_line(episode.told, np.array([0.02, 0.0, 0.0]), speed=0.1), "lift")
        ends.append(episode.trace.qpos)
    np.testing.assert_array_equal(ends[0], ends[1])


def test_a_rehearsal_tells_a_grasp_that_will_hold_from_one_that_will_not(pad_hand, pad_grasp, block):
    q, contacts = pad_grasp
    slab = box((-0.3, -0.3, -0.06), (0.3, 0.3, block.bounds[0, 2]))
    drifts = []
    for mass in (
        0.1,
        1.5,
    ):  # the pads' 8 N carry 0.75 * 0.8 * 8 N = 4.8 N; 1.25 times these masses weigh 1.2 N and 18 N
        scene = Scene(block, slab, np.eye(4), np.array([1.0, 0.0, 0.0]), mass=mass)
        rehearsal = lift_rehearsal(push_model_xml(pad_hand, scene), pad_hand, scene)
        drifts.append([rehearsal(q, contacts, np.eye(4)) for _ in range(2)])
    assert drifts[0][0] < 0.2
    assert drifts[1][0] > 1.0
    assert drifts[0][0] == drifts[0][1]  # what was rehearsed before changes nothing
