"""Verifying the same draws again gives what verifying them in a scene with those parameters gives."""

import numpy as np
import pytest

from dexnudge.experiments.disturbances import VERIFIED_AT, setting_name, verify_disturbed
from dexnudge.scenes.scene import Scene
from dexnudge.verification.verdicts import verify


@pytest.fixture(scope="module")
def scene(block_scene):
    """A slippery hand on a heavy block, so that every quantity decides for some of the configurations."""
    return Scene(
        block_scene.object_mesh,
        block_scene.environment_mesh,
        block_scene.T_world_object,
        block_scene.motion,
        friction_hand=0.5,
        mass=0.25,
    )


@pytest.fixture(scope="module")
def q(upright, tip_height):
    """Presses along the block, from one fingertip to both, one too deep, one in the air, one that is no pose."""
    rows = []
    for x, gap in [(x, 0.001) for x in np.linspace(-0.095, 0.095, 15)] + [(0.0, -0.0015), (0.0, 0.02)]:
        row = upright.copy()
        row[:3] = [x, 0.0, 0.02 + tip_height + gap]
        rows.append(row)
    rows.append(np.full(13, np.nan))
    return np.array(rows)


@pytest.fixture(scope="module")
def swept(boxy_hand, scene, q):
    verdicts = verify(scene, boxy_hand, q)
    return verdicts, verify_disturbed(scene, verdicts)


@pytest.mark.parametrize(("quantity", "factor"), VERIFIED_AT)
def test_it_equals_verifying_a_scene_that_was_built_so(boxy_hand, scene, q, swept, quantity, factor):
    values = {name: getattr(scene, name) for name, _ in VERIFIED_AT}
    values[quantity] *= factor
    built = Scene(scene.object_mesh, scene.environment_mesh, scene.T_world_object, scene.motion, **values)
    assert swept[1][setting_name(quantity, factor)] == verify(built, boxy_hand, q).success.tolist()


def test_the_settings_matter_here(swept):
    """Else the test above could not fail."""
    verdicts, found = swept
    assert len(found) == len(VERIFIED_AT) == 6
    assert {"penetration_object", "contact", "valid_pose"} <= set(verdicts.reasons)
    assert 0 < verdicts.success.sum() < len(verdicts.success)
    assert sum(found["friction_hand x 0.75"]) < verdicts.success.sum() < sum(found["friction_environment x 0.5"])
    assert not any(ok for flags in found.values() for ok in flags[-3:])


def test_without_a_draw_that_could_move_the_object_nothing_succeeds(boxy_hand, scene, q):
    assert verify_disturbed(scene, verify(scene, boxy_hand, q[-3:]))["mass x 2"] == [False] * 3
