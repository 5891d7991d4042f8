"""An object by name or by file."""

import numpy as np
import pytest
import trimesh

from dexnudge.errors import MeshError, UnknownNameError
from dexnudge.objects.builtin import describe_builtin_names
from dexnudge.objects.sets import resolve_object


def test_a_built_in_name_and_a_file(tmp_path):
    assert resolve_object("phone").name == "phone"
    assert resolve_object("phone", length=0.12).mesh.extents.max() == pytest.approx(0.12)
    trimesh.creation.box((150, 70, 8)).export(tmp_path / "mine.stl")
    found = resolve_object(str(tmp_path / "mine.stl"), units="mm")
    assert found.name == "mine"
    np.testing.assert_allclose(found.mesh.extents, [0.15, 0.07, 0.008], rtol=1e-6)


def test_an_unknown_name_lists_the_valid_ones():
    with pytest.raises(UnknownNameError) as caught:
        resolve_object("fone")
    assert str(caught.value) == (
        "unknown object 'fone' (did you mean 'phone'?); expected a mesh file (obj, stl, ply, glb, off, dae) "
        "or a built-in object: " + describe_builtin_names()
    )


def test_a_missing_file_is_called_a_missing_file(tmp_path):
    with pytest.raises(MeshError, match="does not exist"):
        resolve_object(str(tmp_path / "gone.obj"))
    with pytest.raises(MeshError, match="unknown mesh format"):
        resolve_object(str(tmp_path / "gone"))


def test_an_implausible_length_is_refused():
    with pytest.raises(MeshError, match="`length` is 150 m"):
        resolve_object("phone", length=150.0)
