"""A parallel gripper from its description to a push that is played."""

import numpy as np

import dexnudge as dn


def test_two_jaws_are_drawn_verified_and_push(two_jaws):
    scene = dn.build_scene("table", "phone", seed=0, max_normal_force=10.0)  # jaws hold more than a finger on a tendon
    samples = dn.Sampler(two_jaws).sample(scene, num=16, seed=0, method="random_start_projection")
    verified = samples.q[samples.success]
    assert len(verified) > 0
    width = verified[:, 9]
    assert (width >= 0.0).all()
    assert (width <= 0.04 + 1e-6).all()
    assert np.ptp(width) > 0.001, "the jaws are opened as the object asks for"
    assert any(dn.execute(sample).success for sample in samples.verified[:3])
