"""Rotations against SciPy's, and the 6D representation's convention."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from moves import rotation_vector_to_matrix
from scipy.spatial.transform import Rotation

from dexnudge.geometry.transforms import matrix_to_rotation_6d, rotation_6d_to_matrix

NUMBERS = st.floats(-3, 3, allow_subnormal=False)


def random_rotations(count):
    return torch.as_tensor(Rotation.random(count, rng=np.random.default_rng(0)).as_matrix())


def test_six_numbers_are_the_first_two_columns_stacked():
    matrix = torch.as_tensor(Rotation.from_euler("z", 90, degrees=True).as_matrix())
    # R e_x = e_y and R e_y = -e_x; stacked rows would begin (0, -1, 0).
    torch.testing.assert_close(matrix_to_rotation_6d(matrix), torch.tensor([0, 1, 0, -1, 0, 0], dtype=torch.float64))


def test_round_trip():
    matrices = random_rotations(100).reshape(4, 25, 3, 3)
    torch.testing.assert_close(rotation_6d_to_matrix(matrix_to_rotation_6d(matrices)), matrices)


@given(st.lists(NUMBERS, min_size=6, max_size=6))
@settings(deadline=None)
def test_any_six_numbers_give_a_proper_rotation(numbers):
    first, second = np.asarray(numbers[:3]), np.asarray(numbers[3:])
    scale = np.linalg.norm(first) * np.linalg.norm(second)
    if np.linalg.norm(np.cross(first, second)) < 1e-3 * max(scale, 1e-3):
        return  # parallel columns fix no rotation
    matrix = rotation_6d_to_matrix(torch.tensor([numbers], dtype=torch.float64))[0].numpy()
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(matrix) > 0
    np.testing.assert_allclose(matrix[:, 0], first / np.linalg.norm(first), atol=1e-9)
    assert matrix[:, 1] @ second > 0
    assert abs(matrix[:, 2] @ second) < 1e-6


def test_gradient_of_the_6d_map():
    x = torch.randn(3, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    assert torch.autograd.gradcheck(rotation_6d_to_matrix, (x,))


def test_rotation_vectors_equal_scipys():
    vectors = np.random.default_rng(1).normal(size=(200, 3)) * np.geomspace(1e-9, 3, 200)[:, None]
    expected = Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(rotation_vector_to_matrix(torch.as_tensor(vectors)).numpy(), expected, atol=1e-12)


def test_zero_rotation_vector_is_the_identity():
    torch.testing.assert_close(rotation_vector_to_matrix(torch.zeros(2, 3)), torch.eye(3).expand(2, 3, 3))
