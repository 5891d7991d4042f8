"""What a hand looks like: the visual meshes of its description, where that has such. Nothing is judged on them."""

import numpy as np
import trimesh

from dexnudge.errors import HandError
from dexnudge.geometry.thinning import thinned
from dexnudge.hands.hand import Hand
from dexnudge.jobs.cached import cached_per_instance

MOST_TRIANGLES = 6_000  # of a link, so that pages of hands and arms stay below a few megabytes
APART = 0.5  # of a judged mesh's diagonal, by which the middles of its box and that of the visual mesh differ at most
LARGER = 2.5  # times as long may the one diagonal be as the other


@cached_per_instance
def visual_meshes(hand: Hand) -> tuple[trimesh.Trimesh, ...]:
    """Return the meshes to show for each link, link frame [m]: those of `hand.shown_by`, or else the judged ones.

    A link whose visual mesh is elsewhere than its judged one, as where its frame was moved, is shown as it is judged.
    """
    from dexnudge.hands.registry import read_tree

    shown: dict[str, trimesh.Trimesh] = {}
    for path in hand.shown_by:
        try:
            shown |= read_tree(path, "visual").links
        except HandError:  # what is only to be looked at may be missing, or of a kind that is not read
            continue
    pairs = zip(hand.link_names, hand.link_meshes, strict=True)
    return tuple(_thinned(shown[name]) if _alike(shown.get(name), mesh) else mesh for name, mesh in pairs)


@cached_per_instance
def _thinned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return thinned(mesh, most=MOST_TRIANGLES)


def _alike(shown: trimesh.Trimesh | None, judged: trimesh.Trimesh) -> bool:
    """Return whether two meshes are two descriptions of one body."""
    if shown is None or not len(shown.faces) or not len(judged.faces) or _same(shown, judged):
        return False
    sizes = [float(np.linalg.norm(mesh.extents)) for mesh in (shown, judged)]
    apart = float(np.linalg.norm(shown.bounds.mean(axis=0) - judged.bounds.mean(axis=0)))
    return apart < APART * sizes[1] and max(sizes) < LARGER * min(sizes)


def _same(shown: trimesh.Trimesh, judged: trimesh.Trimesh) -> bool:
    return shown.vertices.shape == judged.vertices.shape and bool(np.allclose(shown.vertices, judged.vertices))
