"""The generator of closed bodies: closed, exact in size, and of the volume that calculus gives."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dexnudge.objects.slab import SlabShape, slab_mesh

FRACTION = st.floats(0.0, 1.0)


def test_without_roundings_it_is_a_box():
    mesh = slab_mesh(SlabShape((0.2, 0.1, 0.03), corner=0.0, edge=1e-6))
    assert mesh.volume == pytest.approx(0.2 * 0.1 * 0.03, rel=1e-4)
    assert mesh.area == pytest.approx(2 * (0.2 * 0.1 + 0.2 * 0.03 + 0.1 * 0.03), rel=1e-4)


def test_rounded_corners_cut_off_what_circles_leave():
    length, width, thickness, corner = 0.2, 0.1, 0.02, 0.4
    mesh = slab_mesh(SlabShape((length, width, thickness), corner=corner, corner_length=corner, edge=1e-6))
    radius = corner * width / 2
    expected = thickness * (length * width - (4 - np.pi) * radius**2)
    assert mesh.volume == pytest.approx(expected, rel=5e-3)


def test_a_round_edge_all_round_is_half_a_cylinder():
    length, width, thickness = 0.2, 0.1, 0.02
    mesh = slab_mesh(SlabShape((length, width, thickness), corner=0.0, edge=1.0))
    radius = thickness / 2
    core = (length - thickness) * (width - thickness) * thickness
    sides = np.pi * radius**2 / 2 * 2 * (length + width - 2 * thickness)
    assert mesh.volume == pytest.approx(core + sides, rel=0.02)


def test_a_dome_adds_its_integral_before_the_body_is_fitted_to_its_size():
    length, width, thickness, height = 0.2, 0.1, 0.02, 0.01
    shape = SlabShape(
        (length, width, thickness), corner=0.0, edge=1e-6, top=lambda x, y: height * (1 - y**2) + 0 * x, cells=(10, 40)
    )
    expected = length * width * (thickness + height * 2 / 3) * thickness / (thickness + height)
    assert slab_mesh(shape).volume == pytest.approx(expected, rel=1e-3)


@settings(max_examples=40)
@given(FRACTION, FRACTION, FRACTION, FRACTION, st.integers(0, 2**16))
def test_it_is_closed_and_of_its_size_for_all_parameters(corner, reach, edge, bulge, seed):
    generator = np.random.default_rng(seed)
    size = tuple(generator.uniform(low, high) for low, high in ((0.09, 0.25), (0.04, 0.08), (0.008, 0.03)))
    mesh = slab_mesh(
        SlabShape(
            size,
            corner=0.8 * corner,
            corner_length=0.05 + 0.9 * reach,
            edge=0.03 + 0.97 * edge,
            width_at=lambda x: 1 - 0.3 * corner * np.cos(np.pi * x / 2) ** 2,
            top=lambda x, y: bulge * size[2] * (1 - y**2) * np.cos(2 * x),
            bottom=lambda x, y: -0.5 * bulge * size[2] * (1 - x**2) + 0 * y,
            rows=(0.1, 0.13),
            columns=(-0.2,),
        )
    )
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.area_faces.min() > 0
    np.testing.assert_allclose(mesh.bounds, [[-side / 2 for side in size], [side / 2 for side in size]], atol=1e-12)
