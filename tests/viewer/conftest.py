"""A recording whose every number is known."""

import numpy as np
import pytest
import trimesh

from dexnudge.viewer.recording import Curve, Recording
from dexnudge.viewer.visual_scene import Part, VisualScene


@pytest.fixture(scope="session")
def recording() -> Recording:
    """A block that rests for 1 s, then slides 100 mm along x in 1 s and turns by 0.1 rad; 41 moments.

    A fingertip follows 80 mm behind it; the arrow is there up to 1.5 s.
    """
    block, tip = trimesh.creation.box((0.1, 0.06, 0.02)), trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    floor = trimesh.creation.box(bounds=[[-0.3, -0.3, -0.03], [0.4, 0.3, -0.01]])
    time = np.linspace(0.0, 2.0, 41)
    frames = []
    for now in time:
        slid = 0.1 * max(0.0, now - 1.0)
        T_world_block = trimesh.transformations.rotation_matrix(slid, [0, 0, 1])
        T_world_block[0, 3] = slid
        T_world_tip = trimesh.transformations.translation_matrix([slid - 0.08, 0.0, 0.02])
        parts = (
            Part("object", "object", block, T_world_block),
            Part("environment", "environment", floor, np.eye(4)),
            Part("tip", "fingertip", tip, T_world_tip),
        )
        frames.append(VisualScene(parts, np.zeros((0, 3)), np.array([1.0, 0, 0]) if now <= 1.5 else np.zeros(3)))
    charts = {
        "way": (
            Curve("along", "mm", 100.0 * np.maximum(time - 1.0, 0.0)),
            Curve("up", "mm", np.full(41, -1e-9)),
        ),
        "force": (Curve("normal", "N", np.where(time < 0.99, np.nan, 3.0 + time)),),
    }
    return Recording(frames, time, ["wait" if now < 0.99 else "push" for now in time], charts, "block", "success")
