"""A hand of two fingers whose long levers press two flat pads on a block from both sides, as good as straight on."""

import numpy as np
import pytest
import trimesh

from dexnudge.hands.hand import Hand, Joint
from dexnudge.mechanics.contacts import HandContacts

LEVER = 0.5  # [m] so long that a pad moves straight for the millimetres that matter
HALF_WIDTH = 0.02  # [m] of the block between the pads
PAD = (0.016, 0.01, 0.016)  # [m]


@pytest.fixture(scope="session")
def pad_hand() -> Hand:
    """Palm far below; joints about +x and -x at (0, 0, -LEVER) bring the pads at y = -+HALF_WIDTH together."""
    links, joints = [trimesh.creation.box((0.02, 0.02, 0.02))], [None]
    for index, side in enumerate((-1.0, 1.0)):
        pad = trimesh.creation.box(PAD)
        pad.apply_translation((0.0, side * (HALF_WIDTH + PAD[1] / 2), LEVER))
        links.append(pad)
        # A turn about +x moves the top toward -y: the pad at -y needs the opposite turn.
        joints.append(Joint(f"slide{index}", np.eye(4), np.array([side, 0.0, 0.0]), index))
    links[0].apply_translation((0.0, 0.0, -0.1))
    return Hand(
        name="pads",
        joint_names=("slide0", "slide1"),
        lower=np.full(2, -0.5),
        upper=np.full(2, 0.5),
        link_names=("palm", "pad0", "pad1"),
        link_parent=np.array([-1, 0, 0]),
        joints=tuple(joints),
        link_meshes=tuple(links),
        fingertips={"A": "pad0", "B": "pad1"},
        couplings=(),
        palm_normal=np.array([0.0, 0.0, 1.0]),
    )


@pytest.fixture(scope="session")
def pad_grasp() -> tuple[np.ndarray, HandContacts]:
    """q with the pads just at the block around the origin, and its contacts: four corners on each side."""
    q = np.array([0.0, 0.0, -LEVER, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    corners = [(x, side * HALF_WIDTH, z) for side in (-1.0, 1.0) for x in (-0.007, 0.007) for z in (-0.007, 0.007)]
    normals = np.repeat([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]], 4, axis=0)
    return q, HandContacts(points=np.array(corners), normals=normals, link=np.repeat([1, 2], 4))


@pytest.fixture(scope="session")
def block() -> trimesh.Trimesh:
    return trimesh.creation.box((0.06, 2 * HALF_WIDTH, 0.04))
