"""A block on a floor and walls to plan around, for the small hand of boxes."""

import numpy as np
import pytest
import trimesh

from dexnudge.scenes.scene import Scene

TIP = 0.011 + 0.032 + 0.03  # [m] of the palm's centre over the fingertips at zero joint angles


def block_on(*solids):
    """Scene of a block of 160 x 80 x 20 mm around the origin, its lower side at z = 0, among the solids."""
    pose = np.eye(4)
    pose[2, 3] = 0.01
    mesh = trimesh.util.concatenate([trimesh.creation.box(bounds=bounds) for bounds in solids])
    return Scene(trimesh.creation.box((0.16, 0.08, 0.02)), mesh, pose, np.array([1.0, 0.0, 0.0]))


FLOOR = [[-0.4, -0.4, -0.02], [0.4, 0.4, 0.0]]


@pytest.fixture(scope="session")
def block_scene():
    """The block on a floor of 0.8 x 0.8 m at z = 0."""
    return block_on(FLOOR)


@pytest.fixture(scope="session")
def window_scene():
    """A wall of 10 mm at x = 0.5 m, 2 m wide and high, with a hole of 0.3 x 0.3 m about (y, z) = (0.35, 0)."""
    return block_on(
        FLOOR,
        [[0.495, -1.0, -1.0], [0.505, 0.2, 1.0]],
        [[0.495, 0.5, -1.0], [0.505, 1.0, 1.0]],
        [[0.495, 0.2, 0.15], [0.505, 0.5, 1.0]],
        [[0.495, 0.2, -1.0], [0.505, 0.5, -0.15]],
    )


def configuration(x, y, z, angles=(0.0, 0.0, 0.0, 0.0)):
    """q of the boxy hand, unturned."""
    return np.array([x, y, z, 1, 0, 0, 0, 1, 0, *angles], dtype=float)


@pytest.fixture(scope="session")
def touching():
    """q with both fingertips 0.5 mm above the block."""
    return configuration(0.0, 0.0, 0.02 + TIP + 0.0005)


@pytest.fixture(scope="session")
def at():
    """Builds q of the boxy hand from a place and joint angles."""
    return configuration


@pytest.fixture(scope="session")
def scene_of():
    """Builds the block's scene from boxes given by their bounds."""
    return block_on
