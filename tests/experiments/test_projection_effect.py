"""The projection's effect, measured by the judge: what it must mend, and that its figures are those of the draws."""

from dataclasses import replace

import numpy as np
import pytest

from dexnudge.experiments.comparisons import projection_effect, stage_figures
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.objects.builtin import builtin_object
from dexnudge.sampling.methods import find_method
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.verification.verdicts import Verdicts

NUM, SEED = 12, 3
METHOD = find_method("random_start_projection")


@pytest.fixture(scope="module")
def setting(shadow_hand):
    return Sampler(shadow_hand), shadow_hand, build_scene("table", builtin_object("phone"), seed=0)


def test_projection_gets_hands_out_and_into_contact(setting):
    effect = projection_effect(*setting, num=NUM, seed=SEED, method=METHOD)
    before, after = effect["before"], effect["after"]
    assert before["penetration_mm"] > 3.0, "otherwise there is nothing to do"
    assert after["penetration_mm"] < 0.5 * before["penetration_mm"]
    assert after["verified"] > before["verified"]
    sampler, hand, scene = setting
    draws = sampler.sample(scene, hand=hand, num=NUM, seed=SEED, method=METHOD)
    assert after["verified"] == draws.num_verified
    assert after["force_margin"] == pytest.approx(float(draws.verdicts.force_margin.mean()))


def test_a_method_without_projection_has_no_effect_to_report(setting):
    assert projection_effect(*setting, num=NUM, seed=SEED, method=replace(METHOD, projection=None)) == {}


def test_figures_count_draws_that_are_no_pose_as_without_contact_and_force():
    no_contacts = HandContacts(points=np.zeros((0, 3)), normals=np.zeros((0, 3)), link=np.zeros(0, dtype=np.int64))
    nothing = np.array([np.nan, 0.001])
    verdicts = Verdicts(
        success=np.array([False, True]),
        values={
            "penetration_object": nothing,
            "penetration_environment": nothing / 2,
            "penetration_self": nothing / 4,
            "force_margin": np.array([0.0, 3.0]),
        },
        contacts=[no_contacts, no_contacts],
        contact_links=[[], ["one", "two", "three"]],
        reasons=["valid_pose", ""],
    )
    expected = {
        "verified": 1,
        "contact_links": 1.5,
        "force_margin": 1.5,
        "force_margin_median": 1.5,
        "penetration_mm": 1.0,
    }
    assert stage_figures(verdicts) == pytest.approx(expected)
