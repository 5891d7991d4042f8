"""The Shadow Hand's link meshes as the `gymnasium-robotics` package ships them (in millimetres, without units)."""

import io
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import HandError
from dexnudge.hands.xml_text import refuse_entities

MESH_SUFFIXES = (".stl", ".obj", ".dae", ".ply")
MAX_LINK_FACES = 200_000  # MuJoCo reads no more from one STL file; a link needs some hundreds
MAX_MESH_BYTES = 100_000_000


def mesh_path(filename: str, folder: Path) -> Path:
    """The file that a description in `folder` means by `filename`.

    `package://name/rest` is looked for as `rest` and as `name/rest` below the folder, for lack of a ROS workspace.

    Raises:
        HandError: the path leaves the folder (also through a link in the file system) or there is no such file.
    """
    candidates = [filename]
    if filename.startswith("package://"):
        package, _, rest = filename.removeprefix("package://").partition("/")
        candidates = [rest, f"{package}/{rest}"]
    home = folder.resolve()
    for candidate in candidates:
        path = (home / candidate).resolve()
        if "://" in candidate or not candidate or not path.is_relative_to(home):
            raise HandError(
                f"mesh '{filename}' lies outside the hand's folder: expected a file below {folder}; "
                "copy the meshes beside the description and name them relative to it"
            )
        if path.is_file():
            return path
    raise HandError(
        f"mesh '{filename}' is missing: expected a file below {folder}, found none; "
        "copy it there or mend its name in the description"
    )


def load_link_mesh(path: Path, scale: Float[np.ndarray, " 3"]) -> trimesh.Trimesh:
    """A link's mesh in metres: faces and vertices in the file's order, normals outward.

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
    if not (scale == 1.0).all():
        mesh.apply_scale(scale)
    if mesh.volume < 0.0:
        mesh.invert()
    return mesh


def _parse(path: Path) -> trimesh.Trimesh:
    kind = path.suffix.lower().removeprefix(".")
    content = path.read_bytes()
    if kind == "dae":
        refuse_entities(content.decode("utf-8", errors="replace"), path)
    try:
        # From a stream, so that material and texture files that the mesh names are not followed.
        scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False, maintain_order=True)
        mesh = scene.to_mesh()
    except Exception as error:  # trimesh's readers raise whatever a broken file provokes in them
        raise HandError(
            f"{path}: not readable as {kind}: expected a triangle mesh, got '{type(error).__name__}: {error}'; "
            "mend or re-export the mesh"
        ) from error
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    if kind == "stl":
        mesh.merge_vertices()
    return mesh


MILLIMETRE = 0.001  # [m]


def gymnasium_assets() -> Path:
    """The package's `envs/assets` folder, found without importing the package (its import starts a renderer).

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
    """One link mesh in metres, moved by `transform` (4, 4) into its link frame."""
    mesh = trimesh.load_mesh(gymnasium_assets() / "stls" / "hand" / f"{stem}.stl")
    mesh.apply_scale(MILLIMETRE)
    mesh.merge_vertices()
    if transform is not None:
        mesh.apply_transform(transform)
    return mesh
