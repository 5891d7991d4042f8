"""A batch of hands against the kinematics of one link and one point at a time, and its derivative."""

import numpy as np
import pytest
import torch
import trimesh

from dexnudge.errors import InputError
from dexnudge.hands.batch import HandBatch


@pytest.fixture
def q(boxy_hand):
    generator = torch.Generator().manual_seed(0)
    return torch.randn(3, 9 + boxy_hand.num_joints, dtype=torch.float64, generator=generator)


@pytest.mark.parametrize("dense", [False, True])
def test_points_lie_on_the_links_where_the_hand_is(boxy_hand, q, dense):
    hands = HandBatch(boxy_hand, q, dense=dense)
    own = boxy_hand.dense_points if dense else boxy_hand.sparse_points
    assert hands.points.shape == (3, len(own.points), 3)
    torch.testing.assert_close(hands.T_world_link, boxy_hand.forward_kinematics(q))
    assert torch.equal(hands.joint_angles, q[:, 9:])
    for row in range(3):
        for point in range(0, len(own.points), 7):
            pose = hands.T_world_link[row, own.link[point]].numpy()
            expected = trimesh.transform_points(own.points[point : point + 1], pose)[0]
            np.testing.assert_allclose(hands.points[row, point].numpy(), expected, atol=1e-12)
            assert int(hands.point_links[point]) == own.link[point]


def test_points_are_differentiable_in_the_configuration(boxy_hand, q):
    def some_points(value):
        return HandBatch(boxy_hand, value).points[:, ::40]

    torch.autograd.gradcheck(some_points, q.requires_grad_())


def test_an_array_is_made_into_a_tensor_and_another_shape_is_refused(boxy_hand):
    q = np.zeros((2, 9 + boxy_hand.num_joints))
    assert HandBatch(boxy_hand, q).q.dtype == torch.float64
    with pytest.raises(InputError, match="expects floating-point numbers of shape"):
        HandBatch(boxy_hand, q[:, :9])
