"""The built-in objects: every one closed, metric and in range; the sets apart."""

import numpy as np
import pytest

from dexnudge.errors import UnknownNameError
from dexnudge.objects.builtin import builtin_names, builtin_object, builtin_shape, describe_builtin_names

from .cells import cell_of

PLAIN = ["phone", "remote", "tablet", "book", "box"]
EVERY_SEVENTH = [name for kind in ("train", "test") for name in builtin_names(kind)[::7]]


def test_the_sets_have_their_sizes_and_share_no_name():
    train, test = builtin_names("train"), builtin_names("test")
    assert (len(train), len(test)) == (320, 42)
    assert len(set(train) | set(test)) == 362


def test_the_sets_share_no_proportions():
    def cells(set_name: str) -> set:
        return {
            (name.split("-")[0], *cell_of(name.split("-")[0], builtin_shape(name).size))
            for name in builtin_names(set_name)
        }

    assert cells("train").isdisjoint(cells("test"))


@pytest.mark.parametrize("set_name", ["train", "test"])
def test_every_object_has_the_promised_proportions(set_name):
    for name in builtin_names(set_name):
        length, width, thickness = builtin_shape(name).size
        assert 0.09 <= length <= 0.25, name
        assert 0.14 <= width / length <= 0.75, name
        assert 0.04 <= thickness / length <= 0.25, name


@pytest.mark.parametrize("name", PLAIN + EVERY_SEVENTH)
def test_an_object_is_closed_metric_and_made_of_sound_triangles(name):
    mesh = builtin_object(name)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 2  # one body without handles
    assert 500 <= len(mesh.faces) <= 4000
    np.testing.assert_allclose(mesh.extents, builtin_shape(name).size, rtol=1e-9)
    np.testing.assert_allclose(mesh.bounds.sum(axis=0), 0, atol=1e-12)
    hull = mesh.convex_hull.volume
    assert 0.35 * hull < mesh.volume <= hull * (1 + 1e-9)
    assert mesh.area_faces.min() > 1e-11  # no needle thinner than a few micrometres


@pytest.mark.slow
@pytest.mark.parametrize("set_name", ["train", "test"])
def test_every_object_is_closed(set_name):
    for name in builtin_names(set_name):
        mesh = builtin_object(name)
        assert mesh.is_watertight, name
        assert mesh.volume > 0, name


def test_a_name_always_makes_the_same_object_and_two_names_different_ones():
    np.testing.assert_array_equal(builtin_object("remote-203").vertices, builtin_object("remote-203").vertices)
    sizes = {builtin_shape(name).size for name in builtin_names("train")}
    assert len(sizes) == 320


def test_the_camera_block_stands_on_the_upper_face():
    mesh = builtin_object("phone")
    top = mesh.vertices[mesh.vertices[:, 2] > mesh.bounds[1, 2] - 1e-6]
    assert 0.01 < np.ptp(top[:, 0]) < 0.05
    assert top[:, 0].min() > 0.02


def test_unknown_names_list_the_valid_ones():
    with pytest.raises(UnknownNameError) as caught:
        builtin_object("phone-150")
    assert str(caught.value) == f"unknown built-in object 'phone-150'; expected {describe_builtin_names()}"
    assert describe_builtin_names() == (
        "phone, remote, tablet, book, box, phone-000..095 and phone-200..213, remote-000..111 and remote-200..215, "
        "tablet-000..031 and tablet-200..203, book-000..031 and book-200..203, box-000..047 and box-200..203"
    )
    with pytest.raises(UnknownNameError) as caught:
        builtin_names("all")
    assert str(caught.value) == "unknown built-in set 'all'; expected builtin:train or builtin:test"
