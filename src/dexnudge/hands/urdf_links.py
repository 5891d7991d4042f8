"""Geometry and masses of a URDF's links."""

from collections.abc import Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import HandError
from dexnudge.hands import link_meshes
from dexnudge.hands.link_meshes import load_link_mesh, mesh_path

SHAPES = ("mesh", "box", "cylinder", "sphere", "capsule")
MOST_NAMES = 5  # links that a note names


def link_mesh(
    link: Element, geometry: str, path: Path, packages: Mapping[str, Path | str] | None, notes: list[str]
) -> trimesh.Trimesh:
    """Return all of a link's `collision` or `visual` shapes as one mesh in the link frame [m].

    An element without a shape is left out with a note where the link has others.

    Raises:
        HandError: no shape at all in a link's elements, or one that is not read or has no size.
    """
    where = f"{path}: link '{link.get('name')}'"
    pieces, empty = [], []
    for element in link.findall(geometry):
        shape = element.find("geometry")
        if shape is None or len(shape) != 1:
            empty.append(
                f"expected <{geometry}> with one shape in <geometry>, found {'none' if not shape else 'several'}"
            )
        elif shape[0].tag not in SHAPES:
            empty.append(f"expected {', '.join(SHAPES[:-1])} or {SHAPES[-1]}, got <{shape[0].tag}>")
        else:
            piece = _shape(shape[0], where, path.parent, packages)
            piece.apply_transform(origin(element, where))
            pieces.append(piece)
    if empty and not pieces:
        raise HandError(f"{where}: {empty[0]}; add one, replace it by a mesh, or remove the element")
    if empty:
        notes.append(f"link '{link.get('name')}': {empty[0]}: left out, the link has others")
    if not pieces:
        return trimesh.Trimesh()
    return pieces[0] if len(pieces) == 1 else trimesh.util.concatenate(pieces)


def _shape(shape: Element, where: str, folder: Path, packages: Mapping[str, Path | str] | None) -> trimesh.Trimesh:
    if shape.tag == "mesh":
        file = mesh_path(shape.get("filename") or "", folder, packages)
        return load_link_mesh(file, numbers_of(shape, "scale", (1.0, 1.0, 1.0), where))
    keys = {"box": ("size",), "sphere": ("radius",)}.get(shape.tag, ("radius", "length"))
    sizes = [numbers_of(shape, key, (0.0,) * (3 if key == "size" else 1), where) for key in keys]
    if not all((size > 0.0).all() for size in sizes):
        raise HandError(
            f"{where}: <{shape.tag}>: expected {' and '.join(keys)} above zero, got {shape.attrib}; mend it"
        )
    if shape.tag == "box":
        return link_meshes.box(sizes[0])
    return getattr(link_meshes, shape.tag)(*(float(size[0]) for size in sizes))


def note_masses(links: list[Element], path: Path, notes: list[str]) -> None:
    """Note the links whose mass or moments of inertia cannot be; HandError where one is no number."""
    wrong = []
    for link in links:
        inertial = link.find("inertial")
        where = f"{path}: link '{link.get('name')}'"
        if inertial is None:
            continue
        mass = numbers_of(inertial.find("mass"), "value", (0.0,), where)
        moments = [numbers_of(inertial.find("inertia"), key, (0.0,), where) for key in ("ixx", "iyy", "izz")]
        if min(mass, *moments) <= 0.0:
            wrong.append(str(link.get("name")))
    if wrong:
        more = f" and {len(wrong) - MOST_NAMES} more" if len(wrong) > MOST_NAMES else ""
        notes.append(
            f"mass or moments of inertia of {', '.join(wrong[:MOST_NAMES])}{more} are not above zero: each link has that of "
            "its geometry in plastic"
        )


def origin(element: Element, where: str) -> Float[np.ndarray, "4 4"]:
    """Return the pose in an element's <origin>, that of its parent's frame where there is none."""
    place = element.find("origin")
    transform = trimesh.transformations.euler_matrix(*numbers_of(place, "rpy", (0.0, 0.0, 0.0), where), axes="sxyz")
    transform[:3, 3] = numbers_of(place, "xyz", (0.0, 0.0, 0.0), where)
    return transform


def numbers_of(
    element: Element | None, key: str, default: tuple[float, ...], where: str, *, finite: bool = True
) -> np.ndarray:
    """Return the numbers in an attribute, as many as the default has; the default where there is no such attribute."""
    text = None if element is None else element.get(key)
    if text is None:
        return np.asarray(default)
    try:
        values = np.asarray([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != len(default) or np.isnan(values).any() or (finite and np.isinf(values).any()):
        raise HandError(f"{where}: expected {len(default)} finite number(s) in '{key}', got '{text}'; mend it")
    return values
