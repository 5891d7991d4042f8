"""A box on a board, and hands in it that nobody verified."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from dexnudge.mechanics.contacts import HandContacts
from dexnudge.results.samples import Samples
from dexnudge.scenes.scene import Scene
from dexnudge.verification.verdicts import Verdicts

NOTHING = HandContacts(points=np.zeros((0, 3)), normals=np.zeros((0, 3)), link=np.zeros(0, dtype=np.int64))


@pytest.fixture(scope="session")
def box_scene() -> Scene:
    """A box of 120 x 60 x 20 mm, turned by 0.7 rad, on a board whose top is at z = 0."""
    pose = trimesh.transformations.rotation_matrix(0.7, (0, 0, 1))
    pose[:3, 3] = (0.1, -0.2, 0.01)
    board = trimesh.creation.box((0.6, 0.6, 0.02))
    board.apply_translation((0, 0, -0.01))
    return Scene(trimesh.creation.box((0.12, 0.06, 0.02)), board, pose, np.array([1.0, 0, 0]), mass=0.2)


@pytest.fixture(scope="session")
def box_samples(box_scene, boxy_hand) -> Samples:
    """Five random hands around the box, the first three said to be verified."""
    generator = np.random.default_rng(3)
    rotations = Rotation.random(5, random_state=7).as_matrix()
    q = np.concatenate(
        [
            generator.normal(0.0, 0.1, (5, 3)) + box_scene.T_world_object[:3, 3],
            rotations[:, :, 0],
            rotations[:, :, 1],
            generator.uniform(-0.9, 0.9, (5, 4)),
        ],
        axis=1,
    )
    q[:, 10] = np.minimum(q[:, 9], q[:, 10])  # the second joint follows the first
    success = np.array([True, True, True, False, False])
    reasons = ["" if ok else "contact" for ok in success]
    verdicts = Verdicts(success=success, reasons=reasons, values={}, contacts=[NOTHING] * 5, contact_links=[[]] * 5)
    return Samples(box_scene, boxy_hand, q, verdicts)
