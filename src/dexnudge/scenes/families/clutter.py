"""`clutter`: on a table among six boxes, its path to the edge left free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import SceneError
from dexnudge.scenes.boxes import Outline, box, gap_between, joined, outline_of, rectangle, swept
from dexnudge.scenes.families.table import SLAB, place_near_edge, slab
from dexnudge.scenes.resting import place_at_rest
from dexnudge.scenes.scene import MOTION_LENGTH, Scene

BOXES = 6
SIDES = (0.025, 0.060)  # [m] length and width of a box
HEIGHT = (0.02, 0.12)  # [m] of a box
GAP = (0.004, 0.019)  # [m] from the object's outline; within the 20 mm that the family promises
APART = 0.003  # [m] least distance between two boxes, and to the object's path
TRIES = 150  # places tried for each box
SCALES = (1.0, 0.8, 0.6, 0.4)  # of the boxes; all six are drawn anew, smaller, where one found no place


def clutter(mesh: trimesh.Trimesh, generator: np.random.Generator) -> Scene:
    """As `table`, with six boxes 4 to 19 mm from the object's outline, none where it will slide (0.10 m).

    Raises:
        SceneError: six boxes do not fit around the object.
    """
    resting = place_at_rest(mesh, generator.uniform(-np.pi, np.pi))
    (x, y), motion, drawn = place_near_edge(resting.size, generator)
    outline = outline_of(resting.footprint()) + np.array([x, y])
    path = swept(outline, MOTION_LENGTH * motion[:2])
    for scale in SCALES:
        places = _six_places(outline, path, scale, generator)
        if len(places) == BOXES:
            break
    else:
        raise SceneError(
            f"only {len(places)} of {BOXES} boxes fit around an object of {resting.size[0]:.3f} x "
            f"{resting.size[1]:.3f} m; expected room for all; use a larger object or another seed"
        )
    heights = generator.uniform(*HEIGHT, size=BOXES)
    parts = [slab()] + [
        box((*(place.centre - place.size / 2), 0.0), (*(place.centre + place.size / 2), height), yaw=place.yaw)
        for place, height in zip(places, heights, strict=True)
    ]
    described = [
        {
            "centre": place.centre.tolist(),
            "size": [*place.size.tolist(), float(height)],
            "yaw": place.yaw,
            "gap": place.gap,
        }
        for place, height in zip(places, heights, strict=True)
    ]
    parameters = {"yaw": resting.yaw, **drawn, "boxes": described}
    return Scene(mesh, joined(parts), resting.at(x, y), motion, name="clutter", parameters=parameters)


@dataclass(frozen=True)
class _Place:
    """Where a box stands: centre (2,) and size (2,) [m], yaw [rad], gap to the object's outline [m]."""

    centre: Float[np.ndarray, "2"]
    size: Float[np.ndarray, "2"]
    yaw: float
    gap: float

    def outline(self) -> Outline:
        return rectangle(self.centre, (float(self.size[0]), float(self.size[1])), self.yaw)


def _six_places(outline: Outline, path: Outline, scale: float, generator: np.random.Generator) -> list[_Place]:
    """Places for six boxes, or for as many as were found before one found none."""
    places: list[_Place] = []
    occupied = [path]
    while len(places) < BOXES:
        place = _place(outline, occupied, scale, generator)
        if place is None:
            break
        places.append(place)
        occupied.append(place.outline())
    return places


def _place(outline: Outline, occupied: list[Outline], scale: float, generator: np.random.Generator) -> _Place | None:
    """One more box at the outline, on the table, apart from what is occupied; None where none was found.

    The corner of the box that reaches farthest toward the object stands off a random point of the outline by the
    gap, along the normal there; the outline is convex, so that corner is the nearest.
    """
    edges = np.roll(outline, -1, axis=0) - outline
    lengths = np.linalg.norm(edges, axis=1)
    normals = np.stack([edges[:, 1], -edges[:, 0]], -1) / lengths[:, None]
    for _ in range(TRIES):
        size = scale * generator.uniform(*SIDES, size=2)
        yaw, gap = float(generator.uniform(-np.pi, np.pi)), float(generator.uniform(*GAP))
        edge = generator.choice(len(edges), p=lengths / lengths.sum())
        corners = _Place(np.zeros(2), size, yaw, gap).outline()
        reaching = corners[np.argmin(corners @ normals[edge])]
        centre = outline[edge] + generator.uniform() * edges[edge] + gap * normals[edge] - reaching
        place = _Place(centre, size, yaw, gap)
        candidate = place.outline()
        on_table = np.all(np.abs(candidate) <= np.array(SLAB[:2]) / 2)
        if on_table and all(gap_between(candidate, other) >= APART for other in occupied):
            return place
    return None
