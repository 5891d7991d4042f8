"""What every depth of is known by hand, beside the hand of five boxes: a block on a floor."""

import numpy as np
import pytest
import trimesh

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
