"""A support of which one half leans against the motion: noise to a measured world, an obstacle to a model."""

from dataclasses import replace

import numpy as np
import trimesh

from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.sampling.problem import prepare
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts

LEAN = np.radians(0.5)  # 0.7 mm over half the length of the object


def test_guidance_balances_on_the_supports_that_verification_sees():
    x = np.array([-0.4, 0.0, 0.4])
    z = np.array([0.0, 0.0, 0.4 * np.tan(LEAN)])
    corners = np.array([[xi, y, zi] for xi, zi in zip(x, z, strict=True) for y in (-0.3, 0.3)])
    floor = trimesh.Trimesh(corners, [[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]], process=False)
    pose = np.eye(4)
    pose[2, 3] = 0.005
    model = Scene(trimesh.creation.box((0.16, 0.08, 0.01)), floor, pose, np.array([1.0, 0.0, 0.0]))
    assert prepare(model).balances == ()
    scan = replace(model, surface_noise=0.0005)
    (balance,) = prepare(scan).balances
    assert balance is not None
    supports = support_contacts(scan)
    assert len(balance.support_wrenches) == len(supports.points) >= 4
    np.testing.assert_allclose(supports.normals @ sliding_task(scan).twist.linear, 0.0, atol=1e-9)
