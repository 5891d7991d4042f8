"""Sets of objects: a folder of meshes, a text file of paths, the built-in sets, a DexGraspNet `meshdata` folder."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from dexnudge.errors import InputError, MeshError, UnknownNameError, did_you_mean, printable_name, quote
from dexnudge.geometry.mesh_files import FORMATS
from dexnudge.geometry.meshes import check_length, load_mesh, load_scaled_mesh
from dexnudge.objects.builtin import PLAIN, builtin_names, builtin_object, describe_builtin_names, is_builtin


@dataclass(frozen=True)
class NamedObject:
    """A mesh [m] and the name it goes by in reports."""

    name: str
    mesh: trimesh.Trimesh


def resolve_object(text: str, *, units: str = "m", length: float | None = None) -> NamedObject:
    """Return the object that `text` means: a built-in name, or a path to a mesh file.

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
    if path.suffix.lower().lstrip(".") not in FORMATS and path.name == text and not os.path.exists(path):  # noqa: PTH110
        known = [*PLAIN, *builtin_names("train"), *builtin_names("test")]
        raise UnknownNameError(
            f"unknown object {text!r}{did_you_mean(text, known)}; expected a mesh file ({', '.join(FORMATS)}) "
            f"or a built-in object: {describe_builtin_names()}"
        )
    return NamedObject(name_of(path), load_mesh(path, units=units, length=length))


def object_mesh(
    source: str | Path | trimesh.Trimesh, *, units: str = "m", length: float | None = None
) -> trimesh.Trimesh:
    """Return the mesh [m] of an object given as a name, a file or a mesh; see `resolve_object`."""
    if isinstance(source, trimesh.Trimesh):
        if not len(source.faces) or not np.isfinite(source.vertices).all():
            raise MeshError(
                "the mesh of `object` has no faces, or vertices that are NaN or infinite; expected triangles, all finite"
            )
        return scaled_to_length(source if length is None else source.copy(), length)
    if not isinstance(source, str | Path):
        raise InputError(
            f"`object` is {quote(source)}; expected the name of a built-in object, a mesh file, or a mesh in metres"
        )
    return resolve_object(str(source), units=units, length=length).mesh


def refuse_units(name: str, units: str) -> None:
    """Refuse a unit for built-in objects, which have their size in metres.

    Raises:
        InputError: a unit other than the metre.
    """
    if units != "m":
        raise InputError(
            f"`units` is {units}, but {name!r} is built in and has a size; expected a mesh file, or no `units`; set the "
            "longest side by `length`"
        )


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


BUILTIN_PREFIX = "builtin:"
DEXGRASPNET_MESH = Path("coacd") / "decomposed.obj"  # below <code>/
LONGEST_LIST = 10_000_000  # bytes of a text file of paths
DEXGRASPNET_SCALE = 0.08  # metres per unit: its meshes fill the unit ball, so the half-diagonal becomes 8 cm


@dataclass(frozen=True)
class ObjectEntry:
    """One object of a set; `load()` reads or builds its mesh [m] and raises MeshError where it cannot be used."""

    name: str
    load: Callable[[], trimesh.Trimesh]


def resolve_object_set(text: str, *, units: str = "m", length: float | None = None) -> list[ObjectEntry]:
    """Return the objects that `text` means, in a fixed order, with unique names; nothing is loaded yet.

    Args:
        text: `builtin:train` or `builtin:test`, or so many of one, evenly spaced: `builtin:train:40`; a DexGraspNet
            `meshdata` folder; a folder of mesh files; one mesh file; or a text file with one path per line, relative to
            the file's folder (blank lines and lines that begin with # are skipped).
        units: of mesh files that are not in the DexGraspNet layout.
        length: longest side [m] to scale every object to. Without it, meshes in the layout
            `<code>/coacd/decomposed.obj` are scaled by 0.08, others by `units`.

    Raises:
        UnknownNameError: an unknown built-in set.
        InputError: a unit for a built-in set, or a number of objects that it does not have.
        MeshError: the path does not exist or holds no meshes; a text file names a file that does not exist; a length that
            no object can have.
    """
    if length is not None:
        check_length(length)
    if text.startswith(BUILTIN_PREFIX):
        refuse_units(text, units)
        names = _some_of(*text.removeprefix(BUILTIN_PREFIX).partition(":"))
        return [ObjectEntry(name, partial(object_mesh, name, length=length)) for name in names]
    path = Path(text)
    if not os.path.exists(path):  # noqa: PTH110 - a name of 300 letters does not exist, which is no error
        raise MeshError(
            f"{text}: no such set of objects; expected builtin:train, builtin:test, a folder of meshes, "
            "a DexGraspNet meshdata folder, or a text file of paths"
        )
    if path.is_dir():
        files = _files_in(path)
    elif path.is_file() and path.suffix.lower().lstrip(".") in FORMATS:
        files = [path]
    else:
        files = _listed_in(path)
    return _entries(files, units, length)


def _some_of(set_name: str, colon: str, number: str) -> list[str]:
    """Return the names of a built-in set, or so many of them as `number` says, evenly spaced."""
    names = builtin_names(set_name)
    if not colon:
        return names
    if number not in map(str, range(1, len(names) + 1)):
        raise InputError(
            f"{BUILTIN_PREFIX}{set_name}:{quote(number)[1:-1]} is no set of objects; expected a number from 1 to "
            f"{len(names)} after {BUILTIN_PREFIX}{set_name}:"
        )
    return [names[index * len(names) // int(number)] for index in range(int(number))]


def is_dexgraspnet(path: Path) -> bool:
    """Return whether the path has the layout `<code>/coacd/decomposed.obj`."""
    return Path(*path.parts[-2:]) == DEXGRASPNET_MESH and len(path.parts) > 2


def name_of(file: Path) -> str:
    """Return what the object of a mesh file is called: of DexGraspNet its code, else the file."""
    return printable_name(file.parent.parent.name if is_dexgraspnet(file) else file.stem)


def _files_in(folder: Path) -> list[Path]:
    nested = sorted(code / DEXGRASPNET_MESH for code in folder.iterdir() if (code / DEXGRASPNET_MESH).is_file())
    flat = sorted(file for file in folder.iterdir() if file.is_file() and file.suffix.lower().lstrip(".") in FORMATS)
    if not nested and not flat:
        raise MeshError(
            f"{folder}: no meshes in this folder; expected files of format {', '.join(FORMATS)}, "
            f"or <code>/{DEXGRASPNET_MESH.as_posix()}"
        )
    return nested + flat


def _listed_in(file: Path) -> list[Path]:
    if not file.is_file() or file.stat().st_size > LONGEST_LIST:
        raise MeshError(
            f"{file}: is no file, or larger than {LONGEST_LIST / 1e6:g} MB; expected one mesh path per line"
        )
    try:
        lines = [line.strip() for line in file.read_text(encoding="utf-8").splitlines()]
    except (UnicodeDecodeError, OSError) as error:
        raise MeshError(f"{file}: cannot be read as a text file of mesh paths ({error})") from error
    files = [file.parent / line for line in lines if line and not line.startswith("#")]
    if not files:
        raise MeshError(f"{file}: the list is empty; expected one mesh path per line")
    for number, entry in enumerate(files, 1):
        if entry.suffix.lower().lstrip(".") not in FORMATS or not entry.is_file():
            raise MeshError(
                f"{file}: entry {number}, {str(entry)!r}, is not a mesh file; "
                f"expected the path of an existing file of format {', '.join(FORMATS)}"
            )
    return files


def _entries(files: list[Path], units: str, length: float | None) -> list[ObjectEntry]:
    entries: dict[str, ObjectEntry] = {}
    for file in files:
        stem = name = name_of(file)
        copy = 1
        while name in entries:
            copy += 1
            name = f"{stem}-{copy}"
        if length is None and is_dexgraspnet(file):
            load = partial(load_scaled_mesh, file, DEXGRASPNET_SCALE)
        else:
            load = partial(load_mesh, file, units=units, length=length)
        entries[name] = ObjectEntry(name, load)
    return list(entries.values())
