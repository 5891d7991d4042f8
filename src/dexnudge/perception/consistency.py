"""Depth that other views contradict: strays at edges, bulges where matching failed, reflections that move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from dexnudge.perception.depth_view import DepthView

AGREES = 0.02  # [m] between what two views measured of one place: noise, and the error of their poses
SEEN_THROUGH = 0.03  # [m] beyond a place, where another view saw something through it


def consistent(views: Sequence[DepthView]) -> list[DepthView]:
    """Return the views without the pixels whose place more views saw through than measured something at.

    So a pixel is dropped that no other view confirms and two contradict; two views alone drop nothing.
    """
    kept = []
    for view in views:
        confirmed, contradicted = votes(view.points(), [other for other in views if other is not view])
        depth = view.depth.copy()
        depth[view.measured] = np.where(contradicted > confirmed + 1, 0.0, depth[view.measured])
        kept.append(replace(view, depth=depth) if (depth > 0).any() else view)
    return kept


def votes(
    points: Float[np.ndarray, "n 3"], views: Sequence[DepthView], *, beyond: float = SEEN_THROUGH
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return how many views confirm each point, and how many contradict it: they saw more than `beyond` [m] behind it."""
    confirmed, contradicted = np.zeros(len(points), dtype=int), np.zeros(len(points), dtype=int)
    for view in views:
        inside = np.flatnonzero(view.sees(points))
        u, v, z = view.project(points[inside]).T
        column, row = np.rint(u).astype(int), np.rint(v).astype(int)
        depth = view.depth[row.clip(0, view.height - 1), column.clip(0, view.width - 1)]
        confirmed[inside] += (depth > 0) & (np.abs(depth - z) < AGREES)
        contradicted[inside] += depth > z + beyond
    return confirmed, contradicted
