"""Spread of configurations and of contact places, against plain loops."""

import math

import numpy as np
import pytest

from dexnudge.experiments.diversity import contact_diversity, joint_diversity
from dexnudge.mechanics.contacts import HandContacts


def test_the_joint_spread_is_that_of_each_joint_by_hand():
    q = np.random.default_rng(0).normal(size=(5, 13)).astype(np.float32)
    spreads = []
    for joint in range(9, 13):
        angles = [float(value) for value in q[:, joint]]
        mean = sum(angles) / 5
        spreads.append(math.sqrt(sum((angle - mean) ** 2 for angle in angles) / 4))
    assert joint_diversity(q) == pytest.approx(sum(spreads) / 4, rel=1e-6)


def test_root_poses_do_not_count_and_one_configuration_has_no_spread():
    q = np.random.default_rng(0).normal(size=(5, 13))
    q[:, 9:] = 0.3
    assert joint_diversity(q) == 0.0
    assert joint_diversity(q[:1]) is None
    assert joint_diversity(q[:0]) is None


def contacts(*pairs: tuple[int, list[float]]) -> HandContacts:
    link, points = zip(*pairs, strict=True)
    return HandContacts(points=np.array(points), normals=np.tile([0.0, 0.0, 1.0], (len(link), 1)), link=np.array(link))


def test_the_contact_spread_counts_each_fingertip_once_in_half_lengths(boxy_hand, block_scene):
    tip_a, tip_b, palm = (boxy_hand.link_names.index(name) for name in ("tip_a", "tip_b", "palm"))
    first = contacts((tip_a, [0.02, 0.0, 0.02]), (tip_a, [0.04, 0.0, 0.02]), (palm, [9.0, 9.0, 9.0]))
    second = contacts((tip_a, [-0.03, 0.0, 0.02]), (tip_b, [0.0, 0.04, 0.02]))
    places = [(0.03, 0.0, 0.02), (-0.03, 0.0, 0.02), (0.0, 0.04, 0.02)]
    mean = [sum(axis) / 3 for axis in zip(*places, strict=True)]
    distances = [math.dist(place, mean) for place in places]
    expected = sum(distances) / 3 / 0.08  # the block is 160 mm long
    assert contact_diversity(boxy_hand, block_scene, [first, second]) == pytest.approx(expected)


def test_fewer_than_two_places_have_no_spread(boxy_hand, block_scene):
    tip_a, palm = (boxy_hand.link_names.index(name) for name in ("tip_a", "palm"))
    assert contact_diversity(boxy_hand, block_scene, []) is None
    only = contacts((palm, [0.0, 0.0, 0.0]), (tip_a, [0.0, 0.0, 0.0]), (tip_a, [0.1, 0.0, 0.0]))
    assert contact_diversity(boxy_hand, block_scene, [only]) is None
