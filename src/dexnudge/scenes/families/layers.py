"""`layers`: between two boards, partly exposed, to be pulled out; `slot`: the same with no room for a finger."""

from __future__ import annotations

import numpy as np
import trimesh

from dexnudge.errors import SceneError
from dexnudge.scenes.boxes import box, joined
from dexnudge.scenes.resting import place_at_rest
from dexnudge.scenes.scene import Scene

DEPTH = 0.30  # [m] of both boards, backward from their front edges
BOARD = 0.02  # [m] thickness
SIDE_ROOM = 0.25  # [m] by which the boards are wider than the object: a shelf, not a plank
GAP = (0.010, 0.030)  # [m] from the object's top to the upper board
EXPOSED = (0.20, 0.50)  # of the object's length, in front of the upper board
SLOT_GAP = (0.003, 0.008)  # [m] from the object's top to the upper board: no finger fits in
SLOT_EXPOSED = (0.10, 0.20)  # of the object's length


def layers(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Upper board 10 to 30 mm above the object, 20 to 50 % of it exposed; motion +x, out."""
    return between_boards("layers", mesh, generator, gap=GAP, exposed=EXPOSED)


def slot(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """Upper board 3 to 8 mm above the object, 10 to 20 % of it exposed; motion +x, out."""
    return between_boards("slot", mesh, generator, gap=SLOT_GAP, exposed=SLOT_EXPOSED)


def between_boards(
    name: str,
    mesh: trimesh.Trimesh,
    generator: np.random.Generator,
    *,
    gap: tuple[float, float],
    exposed: tuple[float, float],
) -> Scene:
    """The object lies along x, its front end flush with the front edge of the lower board (x = 0, top at z = 0).

    Both boards are 0.30 m deep. The upper board begins where the exposed part ends.

    Raises:
        SceneError: the object is longer than the boards are deep.
    """
    resting = place_at_rest(mesh, float(generator.integers(2)) * np.pi)
    length, width, height = (float(side) for side in resting.size)
    drawn_gap, drawn_exposed = generator.uniform(*gap), generator.uniform(*exposed)
    if length > DEPTH:
        raise SceneError(
            f"the object is {length:.3f} m long; expected at most {DEPTH:g} m, the depth of the boards of {name!r}; "
            "use a smaller object or your own environment"
        )
    half = (width + SIDE_ROOM) / 2
    front = -drawn_exposed * length
    environment = joined(
        [
            box((-DEPTH, -half, -BOARD), (0.0, half, 0.0)),
            box((front - DEPTH, -half, height + drawn_gap), (front, half, height + drawn_gap + BOARD)),
        ]
    )
    parameters = {"yaw": resting.yaw, "gap": drawn_gap, "exposed_fraction": drawn_exposed}
    return Scene(
        mesh, environment, resting.at(-length / 2, 0.0), np.array([1.0, 0.0, 0.0]), name=name, parameters=parameters
    )
