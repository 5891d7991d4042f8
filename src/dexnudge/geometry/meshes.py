"""Reading meshes from files, and refusing what later steps could not handle.

A mesh leaves here in metres, finite, with at least one triangle, wound outward where it is closed. `metadata` says
what was found and done: `watertight`, `inside_out` (flipped), `winding_repaired`, `scale` (file units to metres).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from dexnudge.errors import MeshError
from dexnudge.geometry.mesh_files import MAX_FACES, read_triangles, too_many_faces

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}  # metres per unit
SHORTEST_OBJECT = 0.02  # [m] longest side; smaller is another tool's work or another unit
LONGEST_OBJECT = 0.6  # [m] longest side; larger does not fit the scenes or is in another unit
LONGEST_ENVIRONMENT = 50.0  # [m] a room; more is another unit
THINNEST_VOLUME = 1e-9  # hull volume / longest side^3; below it a mesh is a sheet, not a body
DEGENERATE_HEIGHT = 1e-9  # of the longest side; a lower triangle has no direction
SMALLEST_AREA = 1e-12  # surface / longest side^2


def load_mesh(path: str | Path, *, units: str = "m", length: float | None = None) -> trimesh.Trimesh:
    """The object in a mesh file, in metres, in the file's own frame.

    Args:
        path: obj, stl, ply, glb, off or dae. Several bodies in one file become one mesh. Materials, textures and
            other files that it names are not read.
        units: the unit of the file's numbers: m, cm, mm or in.
        length: scale so that the longest side of the bounding box is this many metres; `units` is then ignored.

    Raises:
        MeshError: the file is missing, empty, truncated or no mesh; vertices that are not finite; no or more than
            200,000 triangles; no area; a sheet without volume; a longest side outside 0.02..0.6 m.
    """
    path = Path(path)
    mesh = _checked(read_triangles(path), path.name)
    scale = _unit_factor(units)
    if length is not None:
        check_length(length)
        scale = length / float(mesh.extents.max())
    mesh.apply_scale(scale)
    mesh.metadata["scale"] = scale
    check_object_size(mesh, path.name, units=units)
    return mesh


def load_scaled_mesh(path: str | Path, scale: float) -> trimesh.Trimesh:
    """The object in a mesh file whose unit is `scale` metres; otherwise as `load_mesh`, raising as it does."""
    path = Path(path)
    mesh = _checked(read_triangles(path), path.name)
    mesh.apply_scale(scale)
    mesh.metadata["scale"] = scale
    check_object_size(mesh, path.name)
    return mesh


def load_environment(path: str | Path, *, units: str = "m") -> trimesh.Trimesh:
    """The surroundings in a mesh file, in metres, world frame; the same checks as `load_mesh`, without a lower size.

    Open meshes (a single sheet of triangles for a table top) are accepted; their inside is where the surface winds
    around a point, so a closed box is the safer description.

    Raises:
        MeshError: as `load_mesh`; or a longest side above 50 m.
    """
    path = Path(path)
    mesh = _checked(read_triangles(path), path.name)
    scale = _unit_factor(units)
    mesh.apply_scale(scale)
    mesh.metadata["scale"] = scale
    longest = float(mesh.extents.max())
    if longest > LONGEST_ENVIRONMENT:
        raise MeshError(
            f"{path.name}: the longest side of the environment is {longest:.4g} m; expected at most "
            f"{LONGEST_ENVIRONMENT:g} m; is the file in another unit? "
            + _unit_hint(longest / scale, 0.0, LONGEST_ENVIRONMENT, with_length=False)
        )
    return mesh


def check_length(length: float) -> None:
    """Refuse a longest side [m] that no object can have.

    Raises:
        MeshError: outside 0.02..0.6 m, or not finite.
    """
    if not (np.isfinite(length) and SHORTEST_OBJECT <= length <= LONGEST_OBJECT):
        raise MeshError(
            f"length is {length:g} m; expected the longest side of the object in metres, "
            f"between {SHORTEST_OBJECT:g} and {LONGEST_OBJECT:g}"
        )


def check_object_size(mesh: trimesh.Trimesh, name: str, *, units: str = "m") -> None:
    """Refuse an object (metres) that is too long, too short or flat.

    Raises:
        MeshError: naming the units question.
    """
    longest = float(mesh.extents.max())
    if not SHORTEST_OBJECT <= longest <= LONGEST_OBJECT:
        raise MeshError(
            f"{name}: the longest side of the object is {longest:.4g} m; expected {SHORTEST_OBJECT:g} to "
            f"{LONGEST_OBJECT:g} m; is the file in another unit? "
            + _unit_hint(longest / _unit_factor(units), SHORTEST_OBJECT, LONGEST_OBJECT, with_length=True)
        )
    try:
        volume = ConvexHull(mesh.vertices / longest).volume
    except QhullError:
        volume = 0.0
    if volume < THINNEST_VOLUME:
        raise MeshError(f"{name}: the object is a flat sheet; expected a body with a thickness; give it one")


def centre_of_mass(mesh: trimesh.Trimesh) -> np.ndarray:
    """Centre of mass (3,) [m] of a body of even density, in the mesh's frame.

    That of the enclosed volume where the mesh is closed and wound outward; that of the convex hull otherwise, since
    the volume integral of an open mesh means nothing.
    """
    hull = mesh.convex_hull
    if mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0:
        centre = np.asarray(mesh.center_mass)
        equations = ConvexHull(hull.vertices).equations
        if (equations[:, :3] @ centre + equations[:, 3]).max() < 0:
            return centre
    return np.asarray(hull.center_mass)


def _checked(mesh: trimesh.Trimesh, name: str) -> trimesh.Trimesh:
    """`mesh` with one vertex per place and outward winding; MeshError when it is not usable."""
    if len(mesh.faces) == 0:
        raise MeshError(
            f"{name}: the mesh has {len(mesh.vertices)} vertices and no faces; expected triangles; "
            "a point cloud must be meshed first"
        )
    if len(mesh.faces) > MAX_FACES:
        raise too_many_faces(name, len(mesh.faces))
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshError(
            f"{name}: a face names vertex {faces.max()} but the file holds {len(vertices)}; "
            "the file is truncated or damaged: export it again"
        )
    bad = np.count_nonzero(~np.isfinite(vertices).all(axis=1))
    if bad:
        raise MeshError(
            f"{name}: {bad} of {len(vertices)} vertices are NaN or infinite; expected finite numbers; "
            "export the mesh again"
        )
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.update_faces(mesh.nondegenerate_faces(height=DEGENERATE_HEIGHT * float(mesh.extents.max())))
    if not mesh.is_watertight:
        # Closed pieces that touch stay apart: joined at a common edge they would no longer be closed.
        mesh.merge_vertices()
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces) == 0 or not mesh.area > SMALLEST_AREA * float(mesh.extents.max()) ** 2:
        raise MeshError(f"{name}: the surface has no area; expected triangles that span a surface")
    return _outward(mesh)


def _outward(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """`mesh` wound outward; metadata says what had to be done."""
    notes: dict[str, Any] = {"winding_repaired": False, "inside_out": False}
    if not mesh.is_winding_consistent and mesh.is_watertight:
        trimesh.repair.fix_winding(mesh)
        notes["winding_repaired"] = True
    # An open mesh has a volume only relative to a point: its centre is the one that treats all sides alike.
    centred = mesh.triangles - mesh.bounds.mean(axis=0)
    if np.einsum("ij,ij->", centred[:, 0], np.cross(centred[:, 1], centred[:, 2])) < 0:
        mesh.invert()
        notes["inside_out"] = True
    mesh.metadata.update(notes, watertight=bool(mesh.is_watertight))
    return mesh


def _unit_factor(units: str) -> float:
    if units not in UNITS:
        raise MeshError(f"unknown unit {units!r}; expected one of {', '.join(UNITS)}")
    return UNITS[units]


def _unit_hint(raw: float, lowest: float, highest: float, *, with_length: bool) -> str:
    """What to pass so that `raw` file units come out in `lowest`..`highest` metres."""
    fitting = [
        f"`units` {unit} ({raw * factor:.3g} m)" for unit, factor in UNITS.items() if lowest <= raw * factor <= highest
    ]
    if with_length:
        fitting.append("`length` METRES (sets the longest side)")
    return f"Pass {' or '.join(fitting)}" if fitting else "Scale the mesh to metres"
