"""Limits, couplings, surface points and self-collision pairs of a hand."""

import igl
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from dexnudge.errors import HandError
from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import DENSE_SPACING
from dexnudge.hands.registry import load_hand
from dexnudge.hands.urdf import hand_from_urdf

LITE = load_hand("shadow_lite")
FINGERS = ("FF", "MF", "RF")


@given(st.lists(st.floats(-3, 3), min_size=16, max_size=16))
@settings(deadline=None, max_examples=50)
def test_clamp_ends_within_limits_and_couplings(angles):
    q = torch.tensor([[1.0, 2.0, 3.0, 1, 0, 0, 0, 1, 0, *angles]], dtype=torch.float64)
    before = q.clone()
    clamped = LITE.clamp(q)
    assert torch.equal(q, before)
    assert torch.equal(clamped[:, :9], q[:, :9])
    assert (clamped[0, 9:].numpy() >= LITE.lower).all()
    assert (clamped[0, 9:].numpy() <= LITE.upper).all()
    for finger in FINGERS:
        follower, leader = (9 + LITE.joint_names.index(f"{finger}J{number}") for number in (1, 2))
        assert clamped[0, follower] <= clamped[0, leader]
    assert torch.equal(LITE.clamp(clamped), clamped)


def test_clamp_splits_a_violation_evenly():
    q = torch.zeros(1, 25, dtype=torch.float64)
    q[0, 9 + LITE.joint_names.index("FFJ1")], q[0, 9 + LITE.joint_names.index("FFJ2")] = 0.8, 0.4
    clamped = LITE.clamp(q)[0, 9:]
    assert clamped[LITE.joint_names.index("FFJ1")] == pytest.approx(0.6)
    assert clamped[LITE.joint_names.index("FFJ2")] == pytest.approx(0.6)


def test_dense_points_lie_on_their_links_and_cover_them():
    points = LITE.dense_points
    assert (np.diff(points.link) >= 0).all()
    for link, mesh in enumerate(LITE.link_meshes):
        mine = points.points[points.link == link]
        if len(mesh.faces) == 0:
            assert len(mine) == 0
            continue
        assert igl.point_mesh_squared_distance(mine, mesh.vertices, mesh.faces)[0].max() < 1e-12
        rng = np.random.default_rng(5)
        faces = rng.choice(len(mesh.faces), 2000, p=mesh.area_faces / mesh.area)
        places = (rng.dirichlet((1, 1, 1), 2000)[:, :, None] * mesh.triangles[faces]).sum(axis=1)
        assert cKDTree(mine).query(places)[0].max() < DENSE_SPACING


def naive_pairs(hand):
    """The rule written out: unrelated within two generations, and less than 1 mm of overlap at zero by libigl."""
    q = torch.zeros(1, 9 + hand.num_joints, dtype=torch.float64)
    q[0, 3] = q[0, 7] = 1.0
    worlds = hand.forward_kinematics(q)[0].numpy()
    meshes = [mesh.copy().apply_transform(world) for mesh, world in zip(hand.link_meshes, worlds, strict=True)]
    clouds = [
        hand.dense_points.points[hand.dense_points.link == link] @ world[:3, :3].T + world[:3, 3]
        for link, world in enumerate(worlds)
    ]
    pairs = []
    for b in range(len(meshes)):
        for a in range(b):
            parent, grandparent = hand.link_parent[b], hand.link_parent[hand.link_parent[b]]
            if not len(meshes[a].faces) or not len(meshes[b].faces) or a in (parent, grandparent):
                continue
            if max(depth(clouds[a], meshes[b]), depth(clouds[b], meshes[a])) < 0.001:
                pairs.append((a, b))
    return sorted(pairs)


def depth(points, mesh):
    near = points[((points > mesh.bounds[0]) & (points < mesh.bounds[1])).all(axis=1)]
    if len(near) == 0:
        return 0.0
    sign_type = igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
    return max(0.0, -igl.signed_distance(near, mesh.vertices, mesh.faces, sign_type)[0].min())


def test_self_collision_pairs_follow_the_rule():
    pairs = list(LITE.self_collision_pairs)
    assert pairs == naive_pairs(LITE)
    names = {frozenset((LITE.link_names[a], LITE.link_names[b])) for a, b in pairs}
    assert {"ffdistal", "thdistal"} in names
    assert {"ffdistal", "palm"} in names
    assert {"ffproximal", "palm"} not in names  # grandchild
    assert {"ffmiddle", "ffproximal"} not in names  # child


def test_tie_turns_both_joints_of_a_tendon_to_their_mean_and_no_other():
    generator = torch.Generator().manual_seed(5)
    lower, upper = (torch.as_tensor(limit, dtype=torch.float32) for limit in (LITE.lower, LITE.upper))
    angles = lower + (upper - lower) * torch.rand(30, LITE.num_joints, generator=generator)
    q = torch.cat([torch.randn(30, 9, generator=generator), angles], dim=1)
    before = q.clone()
    found = LITE.equalise_tendon_joints(q)
    assert torch.equal(q, before)
    coupled = 9 + LITE.coupled_indices
    assert len(coupled)
    for follower, leader in coupled:
        torch.testing.assert_close(found[:, follower], 0.5 * (before[:, follower] + before[:, leader]))
        assert torch.equal(found[:, follower], found[:, leader])
    others = [index for index in range(q.shape[1]) if index not in coupled]
    assert torch.equal(found[:, others], before[:, others])


def test_yaml_with_wrong_link_names(small_urdf):
    config = HandConfig(palm="palm", fingertips={"F": "nail"}, palm_normal=(0.0, 1.0, 0.0))
    with pytest.raises(HandError) as caught:
        hand_from_urdf(small_urdf, config)
    assert str(caught.value) == (
        "the hand's YAML names an unknown link: key 'fingertips.F': expected one of "
        "['forearm', 'thumb', 'palm', 'finger', 'tip', 'thumbtip', 'pad'], got 'nail'; mend it"
    )
