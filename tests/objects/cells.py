"""Where an object lies in the plane of proportions that splits the sets."""

from dexnudge.objects.builtin import CELLS, KINDS, _thickness_range


def cell_of(kind: str, size: tuple[float, float, float]) -> tuple[int, int]:
    """Column and row of the cell that an object's (length, width, thickness) lies in."""
    width_ratio, thickness_ratio = size[1] / size[0], size[2] / size[0]
    limits = KINDS[kind].width_ratio, _thickness_range(kind, width_ratio)
    shares = (
        (ratio - low) / (high - low) for ratio, (low, high) in zip((width_ratio, thickness_ratio), limits, strict=True)
    )
    column, row = (int(CELLS * share) for share in shares)
    return column, row
