"""Verdicts on made-up traces: one for each thing that can go wrong."""

import numpy as np
import pytest

from dexnudge.simulation.episode import Trace
from dexnudge.simulation.lift_verdict import judge_lift


def trace(*, lifted=0.1, held=0.1, carried=0.0, depth=0.0, attempt=2) -> Trace:
    """An object at 0.5 m that is reached for, lifted and held; of the second try."""
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
        base_pose=np.zeros((count, 7)),
        hand_object_force=np.zeros((count, 2)),
        hand_environment_clearance=np.zeros(count),
        hand_environment_depth=deep,
        carried=forces,
    )


def test_lifted_and_held():
    verdict = judge_lift(trace(), attempt=2, height=0.1)
    assert (verdict.phase, verdict.reason) == ("", "")
    assert verdict.raised == pytest.approx(0.1)
    assert verdict.least_held == pytest.approx(0.1)
    assert verdict.turned_deg == pytest.approx(20.0)
    assert verdict.hand_environment == 0.0


@pytest.mark.parametrize(
    ("changes", "phase", "reason"),
    [
        ({"lifted": 0.03, "held": 0.0}, "lift", "slipped on lift: raised 30 of 100 mm"),
        ({"held": 0.02}, "hold", "dropped in hold: sank to 20 of 100 mm"),
        ({"carried": 0.1}, "hold", "the surroundings still carry it"),
        ({"depth": 0.003}, "lift", "hand 3.0 mm into the environment"),
    ],
)
def test_what_goes_wrong_is_named(changes, phase, reason):
    verdict = judge_lift(trace(**changes), attempt=2, height=0.1)
    assert (verdict.phase, verdict.reason) == (phase, reason)
