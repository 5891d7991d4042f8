"""Objects and surroundings from mesh files: in metres, checked, repaired where that is safe.

A mesh leaves here finite, z up, with at least one triangle, wound outward where it is closed. `metadata` says what was
found and done: `watertight`, `scale` (file units to metres), `file_faces` (which of the file's triangles each one is), and
`notes`, a sentence for each repair or assumption.
"""

from __future__ import annotations

from numbers import Real
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from dexnudge.errors import MeshError, check_path, quote
from dexnudge.geometry.mesh_files import read_triangles
from dexnudge.geometry.mesh_guards import MAX_FACES, MAX_SURROUNDINGS_FACES, too_many_faces
from dexnudge.geometry.mesh_repair import drop_doubled_faces, drop_specks, part_bounds, parts, wind_outward

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}  # metres per unit
SHORTEST_OBJECT = 0.02  # [m] longest side; smaller is another tool's work or another unit
LONGEST_OBJECT = 0.6  # [m] longest side; larger does not fit the scenes or is in another unit
LONGEST_ENVIRONMENT = 50.0  # [m] a room; more is another unit
THINNEST_VOLUME = 1e-9  # hull volume / longest side^3; below it a mesh is a sheet, not a body
DEGENERATE_HEIGHT = 1e-9  # of the longest side; a lower triangle has no direction
FARTHEST_PART = 1e6  # times the largest part: farther away single precision loses the shape of a part
SMALLEST_AREA = 1e-12  # surface / longest side^2


def load_mesh(path: str | Path, *, units: str = "m", length: float | None = None) -> trimesh.Trimesh:
    """Return the object in a mesh file, in metres, in the file's own frame.

    Args:
        path: obj, stl, ply, glb, off or dae. Several bodies in one file become one mesh. Materials, textures and
            other files that it names are not read.
        units: the unit of the file's numbers: m, cm, mm or in.
        length: scale so that the longest side of the bounding box is this many metres; `units` is then ignored.

    Raises:
        MeshError: the file is missing, empty, truncated or no mesh; vertices that are not finite; no or more than
            200,000 triangles; no area; a sheet without volume; a longest side outside 0.02..0.6 m.
    """
    check_path("path", path, MeshError)
    path = Path(path)
    factor = _unit_factor(units)
    mesh = _checked(read_triangles(path), path.name)
    if length is None:
        _scale_to_metres(mesh, factor)
    else:
        check_length(length)
        _scale(mesh, length / float(mesh.extents.max()))
    check_object_size(mesh, path.name, units=units)
    return mesh


def load_scaled_mesh(path: str | Path, scale: float) -> trimesh.Trimesh:
    """Return the object in a mesh file whose unit is `scale` metres; otherwise as `load_mesh`, raising as it does."""
    path = Path(path)
    mesh = _checked(read_triangles(path), path.name)
    _scale(mesh, scale)
    check_object_size(mesh, path.name)
    return mesh


def load_environment(path: str | Path, *, units: str = "m") -> trimesh.Trimesh:
    """Return the surroundings in a mesh file, in metres, world frame; the same checks as `load_mesh`, without a lower size.

    Open meshes (a single sheet of triangles for a table top) are accepted; their inside is where the surface winds
    around a point, so a closed box is the safer description.

    Raises:
        MeshError: as `load_mesh`, but for more than 2 million triangles; or a longest side above 50 m.
    """
    check_path("environment", path, MeshError)
    path = Path(path)
    factor = _unit_factor(units)
    mesh = _checked(read_triangles(path, max_faces=MAX_SURROUNDINGS_FACES), path.name, surroundings=True)
    _scale_to_metres(mesh, factor)
    longest = float(mesh.extents.max())
    if longest > LONGEST_ENVIRONMENT:
        raise MeshError(
            f"{path.name}: the longest side of the environment is {longest:.4g} m; expected at most "
            f"{LONGEST_ENVIRONMENT:g} m; is the file in another unit? "
            + _unit_hint(longest / mesh.metadata["scale"], 0.0, LONGEST_ENVIRONMENT, with_length=False)
        )
    return mesh


def checked_environment(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return surroundings [m, world] that come from no file, checked and repaired as those that do; MeshError.

    Those that need no repair are returned themselves. `metadata["origin"]`, an entry for each face, is kept.
    """
    checked = _checked(mesh, "environment", surroundings=True)
    if np.array_equal(checked.vertices, mesh.vertices) and np.array_equal(checked.faces, mesh.faces):
        return mesh
    if "origin" in mesh.metadata:
        checked.metadata["origin"] = mesh.metadata["origin"][checked.metadata["file_faces"]]
    return checked


def check_length(length: object) -> None:
    """Refuse a longest side [m] that no object can have.

    Raises:
        MeshError: outside 0.02..0.6 m, or no real number.
    """
    real = isinstance(length, Real) and not isinstance(length, bool)
    if not (real and SHORTEST_OBJECT <= length <= LONGEST_OBJECT):  # type: ignore[operator]
        shown = f"{length:g} m" if isinstance(length, float) else quote(length)
        raise MeshError(
            f"`length` is {shown}; expected the longest side of the object in metres, "
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
    if is_flat(mesh):
        raise MeshError(f"{name}: the object is a flat sheet; expected a body with a thickness; give it one")


def is_flat(mesh: trimesh.Trimesh) -> bool:
    """Whether a mesh is a sheet, not a body: next to its longest side its hull has no volume."""
    try:
        return bool(ConvexHull(mesh.vertices / float(mesh.extents.max())).volume < THINNEST_VOLUME)
    except QhullError:
        return True


def centre_of_mass(mesh: trimesh.Trimesh) -> np.ndarray:
    """Return the centre of mass (3,) [m] of a body of even density, in the mesh's frame.

    That of the enclosed volume where the mesh is closed and wound outward; that of the convex hull otherwise, since
    the volume integral of an open mesh means nothing.
    """
    hull = mesh.convex_hull
    if mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0:
        centre = np.asarray(mesh.center_mass)
        plain = hull.face_normals.any(axis=1)  # triangles of no area have no normal
        if (hull.face_normals * (centre - hull.triangles[:, 0])).sum(axis=1)[plain].max() < 0:
            return centre
    return np.asarray(hull.center_mass)


def _scale(mesh: trimesh.Trimesh, scale: float) -> None:
    mesh.apply_scale(scale)
    mesh.metadata["scale"] = scale


def _scale_to_metres(mesh: trimesh.Trimesh, factor: float) -> None:
    """Scale by the unit that the caller gave, or, if that is the metre, by the one that the file states."""
    stated = mesh.metadata["unit"]
    if factor == 1.0 and stated not in (None, 1.0):
        mesh.metadata["notes"].append(f"the file says that its unit is {stated:g} m: scaled so")
        factor = stated
    _scale(mesh, factor)


def _refuse_stray_parts(mesh: trimesh.Trimesh, name: str) -> None:
    """Refuse parts so far from the others that no precision is left; a wrong coordinate is the common cause."""
    triangles = np.asarray(mesh.triangles)
    low, high = part_bounds(triangles, parts(np.asarray(mesh.faces)))
    longest = float((high - low).max())
    if float(mesh.extents.max()) > FARTHEST_PART * longest:
        x, y, z = triangles.reshape(-1, 3)[np.abs(triangles).max(axis=2).argmax()]
        raise MeshError(
            f"{name}: a part of the mesh lies at ({x:.4g}, {y:.4g}, {z:.4g}), the largest part is only {longest:.4g} long; "
            "expected parts that lie together; remove the stray one"
        )


def _checked(mesh: trimesh.Trimesh, name: str, *, surroundings: bool = False) -> trimesh.Trimesh:
    """Return `mesh` with one vertex per place and outward winding, repaired; MeshError when it is not usable."""
    if len(mesh.faces) == 0:
        raise MeshError(
            f"{name}: the mesh has {len(mesh.vertices)} vertices and no faces; expected triangles; "
            "a point cloud must be meshed first"
        )
    limit = MAX_SURROUNDINGS_FACES if surroundings else MAX_FACES
    if len(mesh.faces) > limit:
        raise too_many_faces(name, len(mesh.faces), limit)
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
    metadata = mesh.metadata
    mesh = trimesh.Trimesh(vertices, faces, process=False, face_attributes={"file_face": np.arange(len(faces))})
    _refuse_stray_parts(mesh, name)
    done = [drop_doubled_faces(mesh), None if surroundings else drop_specks(mesh)]
    mesh.update_faces(mesh.nondegenerate_faces(height=DEGENERATE_HEIGHT * float(mesh.extents.max())))
    if not mesh.is_watertight:
        # Closed pieces that touch stay apart: joined at a common edge they would no longer be closed.
        mesh.merge_vertices()
    mesh.remove_unreferenced_vertices()
    if len(mesh.faces) == 0 or not mesh.area > SMALLEST_AREA * float(mesh.extents.max()) ** 2:
        raise MeshError(f"{name}: the surface has no area; expected triangles that span a surface")
    notes = [*metadata.get("notes", ()), *filter(None, done), *wind_outward(mesh, surroundings=surroundings)]
    mesh.metadata.update(notes=notes, unit=metadata.get("unit"), watertight=bool(mesh.is_watertight))
    mesh.metadata["file_faces"] = mesh.face_attributes.pop("file_face")
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
