"""Meshes of a hand's links: where a description's names lead, what is read, and what is shown in their place."""

import os
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import HandError, MeshError
from dexnudge.geometry.coarsening import thinned
from dexnudge.geometry.mesh_files import parse_triangles
from dexnudge.geometry.mesh_repair import wind_outward
from dexnudge.hands.hand import Hand
from dexnudge.hands.xml_text import refuse_entities
from dexnudge.jobs.cached import cached_per_instance


def package_file(package: str, end: str, *, what: str, install: str) -> Path:
    """Return the file of an installed package whose path ends in `end`.

    Args:
        package: name of the distribution, as pip knows it.
        end: last parts of the path, separated by "/".
        what: what it describes, such as "hand 'leap'", for the message.
        install: what to type where the package is missing, for the message.

    Raises:
        HandError: the package is not installed, or has no such file.
    """
    try:
        files = distribution(package).files or []
    except PackageNotFoundError as error:
        raise HandError(
            f"the description of {what} is missing: expected the package {package}, found none; mend it with: {install}"
        ) from error
    found = [path for file in files if str(file).endswith(end) and (path := Path(str(file.locate()))).is_file()]
    if not found:
        raise HandError(
            f"the package {package} has no file {end}, which describes {what}: expected another version of the "
            f"package; mend it with: {install}"
        )
    return found[0]


CIRCLE_SECTIONS = 48  # a circle of radius 10 mm is at most 0.02 mm off its polygon
SPHERE_SUBDIVISIONS = 3  # 1280 faces; a sphere of radius 10 mm is at most 0.07 mm off


def box(size: Float[np.ndarray, " 3"]) -> trimesh.Trimesh:
    """Box of edge lengths `size` [m]."""
    return trimesh.creation.box(extents=size)


def cylinder(radius: float, length: float) -> trimesh.Trimesh:
    """Cylinder about z, from -length/2 to length/2 [m]."""
    return trimesh.creation.cylinder(radius=radius, height=length, sections=CIRCLE_SECTIONS)


def capsule(radius: float, length: float) -> trimesh.Trimesh:
    """Capsule about z: a cylinder from -length/2 to length/2 [m] with half balls on both ends."""
    mesh = trimesh.creation.capsule(radius=radius, height=length, count=[CIRCLE_SECTIONS // 2, CIRCLE_SECTIONS])
    mesh.apply_translation((0.0, 0.0, -mesh.bounds.mean(axis=0)[2]))
    return mesh


def ellipsoid(semi_axes: Float[np.ndarray, " 3"]) -> trimesh.Trimesh:
    """Ellipsoid with the given semi-axes along x, y and z [m]; a sphere where they are equal."""
    mesh = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS, radius=1.0)
    mesh.apply_scale(semi_axes)
    return mesh


def sphere(radius: float) -> trimesh.Trimesh:
    """Sphere of the given radius [m]."""
    return ellipsoid(np.full(3, radius))


MESH_SUFFIXES = (".stl", ".obj", ".dae", ".ply", ".glb")
MAX_LINK_FACES = 200_000  # MuJoCo reads no more from one STL file; a link needs some hundreds
MAX_COORDINATE = 1e5  # [m] a link in micrometres; what is longer than a link is reported with its name
MAX_MESH_BYTES = 100_000_000
LEAST_DEPTH = 2  # of a folder to allow: not the root, nor one that holds everybody's files
PACKAGE_DEPTH = 4  # folders above a description in which its ROS package is looked for
DESCRIPTION_FOLDERS = ("urdf", "robots", "robot", "xacro", "mjcf", "xml")  # stand beside `meshes` in a ROS package
MILLIMETRE = 0.001  # [m]


def mesh_path(filename: str, folder: Path, packages: Mapping[str, Path | str] | None = None) -> Path:
    """Return the file that a description in `folder` means by `filename`.

    It must lie below the folder or, in a ROS package (a folder above with package.xml, or above one called urdf), below
    that, or below a folder in `packages`. `package://name/rest` and `model://name/rest` are looked for in that package
    and, where it is not given, as `rest` and `name/rest` below those folders and the folder above called `name`.

    Raises:
        HandError: the path leaves these folders (also through a link in the file system) or there is no such file.
    """
    home = folder.resolve()
    given = {name: Path(place).resolve() for name, place in (packages or {}).items()}
    roots = [*description_folders(home), *given.values()]
    scheme, found, rest = filename.rpartition("://")
    rest = rest if scheme == "file" else rest.lstrip("/")  # some write `package:///`
    package, _, below = rest.partition("/")
    if not found:
        places = [(root, start / filename) for root in roots for start in (home, root)]
    elif scheme == "file":
        places = [(root, home / rest) for root in roots]
    elif scheme in ("package", "model") and package in given:
        places = [(given[package], given[package] / below)] if below else []
    elif scheme in ("package", "model") and below:
        roots += [parent for parent in list(home.parents)[:PACKAGE_DEPTH] if parent.name == package]
        places = [(root, start / name) for root in roots for start in (home, root) for name in (below, rest)]
    else:
        places = []
    meant = [(root, place.resolve()) for root, place in places if "\0" not in filename]
    inside = [path for root, path in meant if path.is_relative_to(root)]
    for path in inside:
        if os.path.isfile(path):  # noqa: PTH113 - a name of 300 letters is no file, and no error
            return path
    naming = "" if found else ", or name the folder that holds them in `packages`"
    naming += f", or name the folder of '{package}' in `packages`" if found and scheme != "file" and package else ""
    if not inside:
        raise HandError(
            f"mesh '{filename}' lies outside the description's folder: expected a file below {folder}; "
            "copy the meshes beside the description and name them relative to it"
            f"{allowing(home, [path for _, path in meant]) or naming}"
        )
    raise HandError(
        f"mesh '{filename}' is missing: expected a file below {given.get(package, roots[-1])}, found none; "
        f"copy it there or mend its name in the description{naming if found else ''}"
    )


def allowing(home: Path, meant: Sequence[Path]) -> str:
    """Return how one of the files that are meant may be named, if there is one: by a folder that holds it and `home`."""
    there = next((path for path in meant if os.path.exists(path)), Path("/"))  # noqa: PTH110 - as above
    both = Path(os.path.commonpath([home, there]))
    named = f", or allow the folder that holds both: `packages` {both.name}={both}"
    return named if len(both.parts) > LEAST_DEPTH else ""


def description_folders(home: Path) -> list[Path]:
    """Return the folders in which a description's files may lie: its own, and that of the ROS package around it."""
    above = list(home.parents)[:PACKAGE_DEPTH]
    roots = [home, *(parent for parent in above if (parent / "package.xml").is_file())]
    return roots + (above[:1] if home.name in DESCRIPTION_FOLDERS else [])


def load_link_mesh(path: Path, scale: Float[np.ndarray, " 3"]) -> trimesh.Trimesh:
    """Return a link's mesh in metres: faces and vertices in the file's order, normals outward.

    Raises:
        HandError: a format that is not read, or a mesh that is unreadable, empty, not finite or too large.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise HandError(f"{path}: expected a mesh of {', '.join(MESH_SUFFIXES)}, got '{path.suffix}'; convert it")
    if path.stat().st_size > MAX_MESH_BYTES:
        raise HandError(
            f"{path}: expected at most {MAX_MESH_BYTES} bytes, got {path.stat().st_size}; simplify the mesh"
        )
    mesh = _parse(path)
    if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all() or not np.isfinite(scale).all() or not scale.all():
        raise HandError(
            f"{path}: not a usable mesh: expected triangles with finite corners and a scale without zeros, "
            f"got {len(mesh.faces)} triangles and scale {scale.tolist()}; mend or re-export the mesh"
        )
    if len(mesh.faces) > MAX_LINK_FACES:
        raise HandError(
            f"{path}: expected at most {MAX_LINK_FACES} triangles, got {len(mesh.faces)}; simplify the mesh"
        )
    longest = float(np.abs(mesh.vertices).max()) * float(np.abs(scale).max())
    if longest > MAX_COORDINATE:
        raise HandError(
            f"{path}: a corner lies {longest:.3g} m from the origin: expected a link's mesh, within some metres; in "
            'millimetres? give it scale="0.001 0.001 0.001"'
        )
    if not (scale == 1.0).all():
        mesh.apply_scale(scale)
    wind_outward(mesh, surroundings=False)
    return mesh


def _parse(path: Path) -> trimesh.Trimesh:
    kind = path.suffix.lower().removeprefix(".")
    content = path.read_bytes()
    if kind == "dae":
        refuse_entities(content.decode("utf-8", errors="replace"), path)
    try:
        mesh = parse_triangles(content, kind, path.name, keep_order=True, turn=False)
    except MeshError as error:
        raise HandError(
            f"{path}: not readable as {kind}: expected a triangle mesh, got '{error}'; mend or re-export the mesh"
        ) from error
    unit = mesh.metadata["unit"] or 1.0  # like ROS: a COLLADA's unit counts, the axis that it calls up does not
    mesh = trimesh.Trimesh(mesh.vertices * unit, mesh.faces, process=False)
    if kind == "stl" and np.isfinite(mesh.vertices).all():
        mesh.merge_vertices()
    return mesh


def gymnasium_assets() -> Path:
    """Return the package's `envs/assets` folder, found without importing the package (its import starts a renderer).

    Raises:
        HandError: the package is not installed.
    """
    spec = find_spec("gymnasium_robotics")
    if spec is None or spec.origin is None:
        raise HandError(
            "the Shadow Hand's meshes are missing: expected the package gymnasium-robotics, found none; "
            "mend it with: pip install gymnasium-robotics"
        )
    return Path(spec.origin).parent / "envs" / "assets"


def gymnasium_mesh(stem: str, transform: np.ndarray | None = None) -> trimesh.Trimesh:
    """Return one link mesh in metres, moved by `transform` (4, 4) into its link frame."""
    mesh = trimesh.load_mesh(gymnasium_assets() / "stls" / "hand" / f"{stem}.stl")
    mesh.apply_scale(MILLIMETRE)
    mesh.merge_vertices()
    if transform is not None:
        mesh.apply_transform(transform)
    return mesh


MOST_TRIANGLES = 6_000  # of a link, so that pages of hands and arms stay below a few megabytes
APART = 0.5  # of a judged mesh's diagonal, by which the middles of its box and that of the visual mesh differ at most
LARGER = 2.5  # times as long may the one diagonal be as the other


@cached_per_instance
def shown_meshes(hand: Hand) -> dict[str, trimesh.Trimesh]:
    """Return the visual meshes of `hand.shown_by`, by link, link frame of the file [m]."""
    from dexnudge.hands.registry import read_tree

    shown: dict[str, trimesh.Trimesh] = {}
    for path in hand.shown_by:
        try:
            shown |= read_tree(path, "visual").links
        except HandError:  # what is only to be looked at may be missing, or of a kind that is not read
            continue
    return shown


@cached_per_instance
def visual_meshes(hand: Hand) -> tuple[trimesh.Trimesh, ...]:
    """Return the meshes to show for each link, link frame [m]: those of `hand.shown_by`, or else the judged ones.

    A link whose visual mesh is elsewhere than its judged one, as where its frame was moved, is shown as it is judged.
    """
    shown = shown_meshes(hand)
    pairs = zip(hand.link_names, hand.link_meshes, strict=True)
    return tuple(_thinned(shown[name]) if _alike(shown.get(name), mesh) else mesh for name, mesh in pairs)


@cached_per_instance
def _thinned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return thinned(mesh, most=MOST_TRIANGLES)


def _alike(shown: trimesh.Trimesh | None, judged: trimesh.Trimesh) -> bool:
    """Return whether two meshes are two descriptions of one body."""
    if shown is None or not len(shown.faces) or not len(judged.faces):
        return False
    if shown.vertices.shape == judged.vertices.shape and np.allclose(shown.vertices, judged.vertices):
        return False
    sizes = [float(np.linalg.norm(mesh.extents)) for mesh in (shown, judged)]
    apart = float(np.linalg.norm(shown.bounds.mean(axis=0) - judged.bounds.mean(axis=0)))
    return apart < APART * sizes[1] and max(sizes) < LARGER * min(sizes)
