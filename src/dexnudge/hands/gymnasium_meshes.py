"""The Shadow Hand's link meshes as the `gymnasium-robotics` package ships them (in millimetres, without units)."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh

from dexnudge.errors import HandError

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
