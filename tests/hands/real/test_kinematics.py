"""Real hands move here as in MuJoCo, which reads the original files on its own; so do what is exported of them."""

import mujoco
import numpy as np
import pytest
import torch

from dexnudge.hands.export import export_hand
from dexnudge.hands.registry import load_hand

from .catalogue import HANDS, ONE_OF_EACH
from .reference import Reference

TOLERANCE = 1e-6  # [m], and as much in the rotation's entries
DRAWS = 8


def random_q(hand, seed):
    q = np.zeros((DRAWS, 9 + hand.num_joints))
    q[:, 3] = q[:, 7] = 1.0
    q[:, 9:] = np.random.default_rng(seed).uniform(hand.lower, hand.upper, (DRAWS, hand.num_joints))
    return q


def assert_moves_alike(hand, reference, palm, seed=0):
    """Every link that hangs from the palm in both, with geometry or without."""
    below = reference.below(palm)
    links = [link for link in hand.link_names if link in below]
    solid = {link for link, mesh in zip(hand.link_names, hand.link_meshes, strict=True) if len(mesh.faces)}
    assert solid & below <= set(links)
    kept = [hand.link_names.index(link) for link in links]
    q = random_q(hand, seed)
    ours = hand.forward_kinematics(torch.as_tensor(q)).numpy()
    for row in range(DRAWS):
        values = dict(zip(hand.joint_names, q[row, 9:].tolist(), strict=True))
        np.testing.assert_allclose(ours[row, kept], reference.transforms(values, links, palm), rtol=0, atol=TOLERANCE)
    return links


@pytest.mark.parametrize("name", HANDS)
def test_moves_as_the_file_does_in_mujoco(name, real_hand):
    real, hand = HANDS[name], real_hand(name)
    reference = Reference(real.path)
    assert hand.num_joints == real.joints
    palm = real.config.palm
    assert hand.link_names[0] == palm
    followers = set(reference.follows) & {joint.name for joint in hand.joints if joint is not None}
    assert not followers & set(hand.joint_names)
    links = assert_moves_alike(hand, reference, palm)
    assert set(hand.fingertip_links) < set(links)
    assert any("an arm of" in note for note in hand.notes) == real.cut


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_an_export_reads_back_and_moves_alike_in_both_formats(name, real_hand, tmp_path):
    hand = real_hand(name)
    path = export_hand(hand, tmp_path)
    again = load_hand(path)
    assert (again.joint_names, again.fingertips, again.num_joints) == (
        hand.joint_names,
        hand.fingertips,
        hand.num_joints,
    )
    q = torch.as_tensor(random_q(hand, 1))
    order = [again.link_names.index(link) for link in hand.link_names]
    np.testing.assert_allclose(
        again.forward_kinematics(q)[:, order].numpy(), hand.forward_kinematics(q).numpy(), rtol=0, atol=TOLERANCE
    )
    for mesh, other in zip(hand.link_meshes, (again.link_meshes[link] for link in order), strict=True):
        np.testing.assert_array_equal(mesh.vertices, other.vertices)
    model = mujoco.MjModel.from_xml_path(str(path.with_name("hand.xml")))
    assert model.nu == hand.num_joints - len(hand.couplings)
    assert_moves_alike(hand, Reference(path.with_name("hand.xml")), hand.link_names[0], seed=2)
    assert_moves_alike(hand, Reference(path), hand.link_names[0], seed=3)
