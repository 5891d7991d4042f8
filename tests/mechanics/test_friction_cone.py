import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dexnudge.mechanics.friction_cone import EDGE_COUNT, contact_tangents, friction_cone_edges, wrenches

seeds = st.integers(0, 2**32 - 1)


def unit(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@given(seeds)
def test_tangents_are_an_orthonormal_frame_with_the_normal(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normals = unit(rng, 5)
    first, second = contact_tangents(normals, unit(rng, 1)[0])
    frames = np.stack([normals, first, second], axis=2)
    np.testing.assert_allclose(np.swapaxes(frames, 1, 2) @ frames, np.tile(np.eye(3), (5, 1, 1)), atol=1e-12)


@given(seeds, st.floats(0.05, 1.5))
def test_edges_lie_on_the_cone_around_the_inward_normal(seed: int, friction: float) -> None:
    rng = np.random.default_rng(seed)
    normals = unit(rng, 4)
    edges = friction_cone_edges(normals, unit(rng, 1)[0], friction=friction)
    inward = np.einsum("cex,cx->ce", edges, -normals)
    tangential = np.linalg.norm(edges + normals[:, None], axis=2)
    np.testing.assert_allclose(inward, 1.0, atol=1e-12)
    np.testing.assert_allclose(tangential, friction, atol=1e-12)
    assert edges.shape == (4, EDGE_COUNT, 3)


def test_first_edge_drags_along_the_motion() -> None:
    motion = np.array([0.6, 0.8, 0.0])
    edges = friction_cone_edges(np.array([[0.0, 0.0, 1.0]]), motion, friction=0.5)
    np.testing.assert_allclose(edges[0, 0], [0.3, 0.4, -1.0], atol=1e-12)


@pytest.mark.parametrize("normal", [[1.0, 0.0, 0.0], [-0.99, 0.141067359796659, 0.0]])
def test_where_the_motion_is_normal_to_the_surface_the_vertical_orients(normal: list[float]) -> None:
    first, _ = contact_tangents(np.array([normal]), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(first, [[0.0, 0.0, 1.0]], atol=1e-12)


@given(seeds)
def test_turning_everything_about_the_vertical_turns_the_edges(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normals, motion = unit(rng, 3), unit(rng, 1)[0]
    turn = Rotation.from_euler("z", rng.uniform(-3, 3)).as_matrix()
    edges = friction_cone_edges(normals, motion, friction=0.7)
    first = np.abs(normals @ motion) < 0.97  # elsewhere the vertical or the x axis orients
    turned = friction_cone_edges(normals @ turn.T, turn @ motion, friction=0.7)
    np.testing.assert_allclose(turned[first], (edges @ turn.T)[first], atol=1e-9)


def test_torque_is_about_the_centre_over_half_the_length() -> None:
    wrench = wrenches(
        np.array([[0.3, 0.0, 0.0]]), np.array([[0.0, 2.0, 0.0]]), centre=np.array([0.1, 0.0, 0.0]), half_length=0.05
    )
    np.testing.assert_allclose(wrench, [[0, 2, 0, 0, 0, 8]], atol=1e-12)
