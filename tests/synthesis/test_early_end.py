"""A hold test that ends a pull once the object rests gives the verdict of the whole two seconds."""

import numpy as np
import pytest
import torch

from dexnudge.dataset.schema import round_configuration
from dexnudge.energies.kernel_inputs import build_scene_fields
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.geometry.surface_points import surface_points
from dexnudge.hands.hand import Hand
from dexnudge.objects.builtin import builtin_object
from dexnudge.simulation.hold import PULL_STEPS, HoldTest
from dexnudge.synthesis.acceptance import GraspVerifier, floating_scene
from dexnudge.synthesis.grasps import GraspConfig, descend_to_grasp
from dexnudge.synthesis.object_data import TARGET_SPACING, at_rest

BATCH = 24


@pytest.mark.slow
@pytest.mark.parametrize("name", ["box-001", "phone-006"])
def test_the_early_end_changes_no_verdict(hand: Hand, name: str) -> None:
    mesh = at_rest(builtin_object(name))
    q = descend_to_grasp(
        hand,
        build_scene_fields(mesh, None),
        surface_points(mesh, spacing=TARGET_SPACING),
        centre_of_mass(mesh),
        config=GraspConfig(batch=BATCH),
        generator=np.random.default_rng(1),
    )
    q = round_configuration(q.to(torch.float64).numpy())
    verdict = GraspVerifier(hand, floating_scene(mesh))(q)
    simulated = np.flatnonzero(np.isfinite(verdict.hold_translation))
    assert len(simulated) > BATCH / 3
    assert verdict.kept.any()
    contacts = [verdict.contacts[row] for row in simulated]
    short = HoldTest(hand, mesh)(q[simulated], contacts)
    whole = HoldTest(hand, mesh, full_length=True)(q[simulated], contacts)
    for row, one, other in zip(simulated, short, whole, strict=True):
        assert one.reason == other.reason == verdict.reason[row]
        assert one.translation == verdict.hold_translation[row]
        if one.held:
            assert other.steps >= 6 * PULL_STEPS > one.steps
            assert one.translation <= other.translation
        else:  # what went beyond its limit is the run's greatest
            assert one.translation == other.translation or one.rotation == other.rotation
