"""From a real description to a push in MuJoCo: drawn without a prior, verified, executed."""

import pytest
import trimesh

import dexnudge as dn

DRAWS = 24
USED = ("allegro right", "leap left", "inspire", "barrett", "panda")
MOST_FAIL = 2  # of the first verified draws: no prior has been learned for these hands


@pytest.mark.slow
def test_hands_draw_verify_and_execute_on_a_table(real_hand):
    scene, outcomes = dn.build_scene("table", trimesh.creation.box((0.15, 0.08, 0.02))), {}
    for name in USED:
        samples = dn.Sampler(real_hand(name)).sample(scene, num=DRAWS, method="random_start_projection", seed=0)
        verified = [sample for sample in samples if sample.success]
        assert verified, name
        outcomes[name] = dn.execute(verified[0])
    assert all(isinstance(episode.outcome, dn.Outcome) for episode in outcomes.values())
    assert sum(episode.success for episode in outcomes.values()) >= len(USED) - MOST_FAIL
