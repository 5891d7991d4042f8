"""`slot`: as `layers`, with hardly any room above and little exposed."""

from __future__ import annotations

import numpy as np
import trimesh

from dexnudge.scenes.layers import between_boards
from dexnudge.scenes.scene import Scene

GAP = (0.003, 0.008)  # [m] from the object's top to the upper board: no finger fits in
EXPOSED = (0.10, 0.20)  # of the object's length


def slot(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Upper board 3 to 8 mm above the object, 10 to 20 % of it exposed; motion +x, out."""
    return between_boards("slot", mesh, generator, gap=GAP, exposed=EXPOSED)
