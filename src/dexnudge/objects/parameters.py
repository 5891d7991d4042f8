"""Proportions of the built-in objects, and the cells that keep training and test shapes apart.

For each kind the plane of (width / length, thickness / length) is cut into 6 x 6 cells. Cells with
(column + 2 row) mod 5 = 0 are for the test set, the others for training; a draw keeps 10 % of a cell away from its
borders. So no test object has the proportions of a training object of its kind.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CELLS = 6
TEST_MODULUS = 5
CELL_MARGIN = 0.1  # of a cell's side, left free at its borders
FLATNESS = 0.8  # largest thickness / width: thickness must stay the shortest side


@dataclass(frozen=True)
class Proportions:
    """Ranges of one kind of object: `length` [m], width / length, thickness / length."""

    length: tuple[float, float]
    width_ratio: tuple[float, float]
    thickness_ratio: tuple[float, float]


KINDS: dict[str, Proportions] = {
    "phone": Proportions((0.10, 0.18), (0.40, 0.60), (0.04, 0.16)),
    "remote": Proportions((0.10, 0.25), (0.14, 0.42), (0.06, 0.22)),
    "tablet": Proportions((0.17, 0.25), (0.58, 0.75), (0.04, 0.07)),
    "book": Proportions((0.12, 0.25), (0.58, 0.75), (0.05, 0.25)),
    "box": Proportions((0.09, 0.25), (0.30, 0.75), (0.06, 0.25)),
}


def is_test_cell(column: int, row: int) -> bool:
    """Whether a cell of the plane of proportions belongs to the test set."""
    return (column + 2 * row) % TEST_MODULUS == 0


def draw_size(kind: str, generator: np.random.Generator, *, test: bool) -> tuple[float, float, float]:
    """Length, width and thickness [m] of an object of `kind`, from a cell of the wanted set."""
    cells = [(c, r) for c in range(CELLS) for r in range(CELLS) if is_test_cell(c, r) == test]
    column, row = cells[generator.integers(len(cells))]
    offsets = generator.uniform(CELL_MARGIN, 1 - CELL_MARGIN, size=2)
    proportions = KINDS[kind]
    width_ratio = _between(proportions.width_ratio, (column + offsets[0]) / CELLS)
    thickness_ratio = _between(_thickness_range(kind, width_ratio), (row + offsets[1]) / CELLS)
    length = float(generator.uniform(*proportions.length))
    return length, length * width_ratio, length * thickness_ratio


def cell_of(kind: str, size: tuple[float, float, float]) -> tuple[int, int]:
    """Column and row of the cell that an object's (length, width, thickness) lies in."""
    width_ratio, thickness_ratio = size[1] / size[0], size[2] / size[0]
    column = _fraction(KINDS[kind].width_ratio, width_ratio) * CELLS
    row = _fraction(_thickness_range(kind, width_ratio), thickness_ratio) * CELLS
    return int(column), int(row)


def _thickness_range(kind: str, width_ratio: float) -> tuple[float, float]:
    low, high = KINDS[kind].thickness_ratio
    return low, min(high, FLATNESS * width_ratio)


def _between(limits: tuple[float, float], fraction: float) -> float:
    return float(limits[0] + fraction * (limits[1] - limits[0]))


def _fraction(limits: tuple[float, float], value: float) -> float:
    return (value - limits[0]) / (limits[1] - limits[0])
