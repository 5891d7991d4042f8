"""A hand of a palm and one finger, enough to be in the way of something."""

import numpy as np
import pytest
import trimesh

from dexnudge.hands.hand import Hand, Joint


@pytest.fixture(scope="session")
def small_hand() -> Hand:
    """Palm a box of 60 x 60 x 20 mm; the finger along +z turns about x, and bends toward +y."""
    palm, finger = trimesh.creation.box((0.06, 0.06, 0.02)), trimesh.creation.box((0.016, 0.016, 0.05))
    finger.apply_translation((0.0, 0.0, 0.025))
    origin = np.eye(4)
    origin[2, 3] = 0.012
    return Hand(
        name="small",
        joint_names=("bend",),
        lower=np.array([0.0]),
        upper=np.array([1.5]),
        link_names=("palm", "finger"),
        link_parent=np.array([-1, 0]),
        joints=(None, Joint("bend", origin, np.array([-1.0, 0.0, 0.0]), 0)),
        link_meshes=(palm, finger),
        fingertips={"F": "finger"},
        couplings=(),
        palm_normal=np.array([0.0, 1.0, 0.0]),
    )
