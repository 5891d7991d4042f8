"""Whether an object is in one piece: two things in one file, or a stray part, are sampled for as if they were one body."""

from __future__ import annotations

import numpy as np
import trimesh

from dexnudge.finding import Finding, length_text
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.mesh_repair import parts
from dexnudge.geometry.surface_lattice import distinct_rows, surface_lattice

APART = 0.1  # of the object's longest side: keys, lids and the parts of an assembly lie nearer to one another
SPACING = 0.02  # of the same, between the points from which a gap is measured


def loose_parts_findings(object_mesh: trimesh.Trimesh) -> list[Finding]:
    """Return a warning where parts of an object are farther than a tenth of its length from those around its largest one."""
    faces = distinct_rows(np.asarray(object_mesh.vertices))[1][object_mesh.faces]
    part = parts(faces)
    count, length = int(part.max()) + 1, float(object_mesh.extents.max())
    if count == 1:
        return []
    points, face = surface_lattice(np.asarray(object_mesh.triangles), spacing=SPACING * length)[:2]
    owner = part[face]
    added = np.arange(count) == np.bincount(part, object_mesh.area_faces).argmax()
    away = np.full(count, np.inf)  # from the nearest part that belongs to the largest one
    belongs = np.zeros(count, dtype=bool)
    while added.any():
        belongs |= added
        near = trimesh.Trimesh(object_mesh.vertices, object_mesh.faces[added[part]], process=False)
        others = ~belongs[owner]
        np.minimum.at(away, owner[others], ExactDistance(near).to_surface(points[others], reach=2 * length).distance)
        added = ~belongs & (away <= APART * length)
    if belongs.all():
        return []
    loose, gap = np.count_nonzero(~belongs), float(away[~belongs].min())
    which = "a part of the object lies" if loose == 1 else f"{loose} parts of the object lie"
    sentence = (
        f"{which} {length_text(gap)} away from the rest, {gap / length:.0%} of its length; they count as one body"
    )
    return [Finding("warning", "size", sentence, "if they are several things, leave one of them in the mesh")]
