"""`deep`: as `shelf`, in a low cell and far behind the opening."""

from __future__ import annotations

import numpy as np
import trimesh

from dexnudge.scenes.scene import Scene
from dexnudge.scenes.shelf import in_cell

HEIGHT = (0.12, 0.16)  # [m] inside
FRONT_GAP = (0.08, 0.18)  # [m] from the opening back to the object's front end


def deep(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Cell 0.12-0.16 high; object 0.08 to 0.18 m behind the front edge, as far as it fits; motion +x, out."""
    return in_cell("deep", mesh, generator, height=HEIGHT, front_gap=FRONT_GAP)
