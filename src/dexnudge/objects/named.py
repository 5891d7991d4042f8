"""An object given on the command line: a mesh file or a built-in name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import trimesh

from dexnudge.errors import UnknownNameError
from dexnudge.geometry.mesh_files import FORMATS
from dexnudge.geometry.meshes import check_length, load_mesh
from dexnudge.objects.builtin import builtin_object, describe_builtin_names, is_builtin


@dataclass(frozen=True)
class NamedObject:
    """A mesh [m] and the name it goes by in reports."""

    name: str
    mesh: trimesh.Trimesh


def resolve_object(text: str, *, units: str = "m", length: float | None = None) -> NamedObject:
    """The object that `text` means: a built-in name, or a path to a mesh file.

    Args:
        text: "phone", "remote-203", "parts/phone.stl". A built-in name wins over a file of that name; write
            "./phone" for the file.
        units: of the file's numbers.
        length: longest side [m] to scale to, for files and built-in objects alike.

    Raises:
        UnknownNameError: neither a built-in name nor something that could be a mesh file; lists the names.
        MeshError: the file cannot be used.
    """
    if is_builtin(text):
        return NamedObject(text, scaled_to_length(builtin_object(text), length))
    path = Path(text)
    if path.suffix.lower().lstrip(".") not in FORMATS and not path.exists() and path.name == text:
        raise UnknownNameError(
            f"unknown object {text!r}; expected a mesh file ({', '.join(FORMATS)}) or a built-in object: "
            f"{describe_builtin_names()}"
        )
    return NamedObject(path.stem, load_mesh(path, units=units, length=length))


def scaled_to_length(mesh: trimesh.Trimesh, length: float | None) -> trimesh.Trimesh:
    """`mesh` with its longest side `length` metres long, or as it is for None.

    Raises:
        MeshError: the length is not a plausible object's.
    """
    if length is None:
        return mesh
    check_length(length)
    mesh.apply_scale(length / float(mesh.extents.max()))
    return mesh
