"""What every depth of is known by hand: the hand of five boxes and a block on a floor; and rows of that kind."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from dexnudge.experiments.experiment_rows import Executed
from dexnudge.experiments.rows import Row
from dexnudge.scenes.scene import Scene

TIP = 0.011 + 0.032 + 0.03
"""Height of the palm's centre over the fingertips at zero joint angles [m]."""


@pytest.fixture(scope="session")
def tip_height() -> float:
    """Height of the palm's centre over the fingertips at zero joint angles [m]."""
    return TIP


@pytest.fixture(scope="session")
def block_scene() -> Scene:
    """A block of 160 x 80 x 20 mm on a floor at z = 0, to be moved along x."""
    floor = trimesh.creation.box(bounds=[[-0.4, -0.4, -0.02], [0.4, 0.4, 0.0]])
    pose = np.eye(4)
    pose[2, 3] = 0.01
    return Scene(trimesh.creation.box((0.16, 0.08, 0.02)), floor, pose, np.array([1.0, 0.0, 0.0]))


@pytest.fixture(scope="session")
def upright() -> np.ndarray:
    """q of the boxy hand at the origin, unturned, at zero joint angles."""
    q = np.zeros(13)
    q[3] = q[7] = 1.0
    return q


@pytest.fixture
def made_up_rows() -> list[Row]:
    """Four objects of four draws each, one of which failed; every figure of theirs is easily found by hand."""

    def row(name: str, success: list[bool], margin: list[float], own_rank: list[int], depths: list[float]) -> Row:
        return Row(
            object=name,
            scene="table",
            method="steered_noise",
            status="sampled",
            num=4,
            seed=0,
            success=success,
            force_margin=margin,
            penetration_mm=depths,
            own_rank=own_rank,
            rejected={"force": success.count(False)} if False in success else {},
            seconds={"load": 9.0, "prepare": 0.5, "draw": 1.0, "verify": 0.5},
        )

    return [
        row("a", [True, True, True, False], [3.0, 1.6, 1.2, 2.9], [1, 0, 2, 3], [0.0, 0.0, 0.5, 2.0]),
        row("b", [True, False, False, False], [1.2, 0.5, 0.5, 0.5], [3, 2, 1, 0], [0.2, 0.3, 0.4, 0.6]),
        row("c", [False] * 4, [0.5] * 4, [0, 1, 2, 3], [1.5, 4.0, 0.1, None]),
        Row(object="d", scene="table", method="steered_noise", status="failed", reason="MeshError: no", num=4, seed=0),
    ]


@pytest.fixture(scope="session")
def executed() -> Callable[..., Executed]:
    """Makes an executed configuration: a success unless it is given a reason."""

    def make(rank=0, margin=2.0, reason="", *, links=2, behaviour="push", changed=None) -> Executed:
        return Executed(
            rank=rank,
            force_margin=margin,
            links=links,
            behaviour=behaviour,
            success=not reason,
            reason=reason,
            advanced=0.09,
            turned_deg=1.0,
            sunk=0.0,
            hand_environment=0.0,
            cone_share=0.5,
            approach="straight",
            changed=changed or {},
        )

    return make
