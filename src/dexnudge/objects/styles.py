"""What the built-in objects look like: one function per style, from a size and a generator to a shape.

Heights are fractions of the thickness; `slab_mesh` fits the body to its size afterwards, so proportions are exact
whatever bulges or bends. x runs along the length, y along the width, both in -1..1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from dexnudge.objects.slab import Heights, SlabShape

Size = tuple[float, float, float]
Style = Callable[[Size, Generator], SlabShape]


def plain_phone(size: Size, generator: Generator) -> SlabShape:
    """A bar with rounded corners and edges."""
    corner = generator.uniform(0.15, 0.45)
    return SlabShape(size, corner=corner, corner_length=corner, edge=generator.uniform(0.4, 1.0))


def camera_phone(size: Size, generator: Generator) -> SlabShape:
    """A bar with a raised camera block on its upper face, in a corner or in the middle of one end."""
    top, rows, columns = _camera(size, generator)
    return replace(plain_phone(size, generator), top=top, rows=rows, columns=columns)


def curved_phone(size: Size, generator: Generator) -> SlabShape:
    """A bar whose back (below) bulges."""
    bar = plain_phone(size, generator)
    return replace(bar, bottom=_dome(-generator.uniform(0.3, 0.8) * size[2]))


def open_flip_phone(size: Size, generator: Generator) -> SlabShape:
    """Two halves at an angle, with a groove at the hinge."""
    bend, hinge = _bend(generator.uniform(0.6, 1.2) * size[2]), _groove(-generator.uniform(0.1, 0.25) * size[2])
    return replace(
        plain_phone(size, generator), top=lambda x, y: bend(x, y) + hinge(x, y), bottom=bend, rows=(-0.06, 0.0, 0.06)
    )


def closed_flip_phone(size: Size, generator: Generator) -> SlabShape:
    """Two halves on each other, with a seam around three sides and a domed upper half."""
    bar = plain_phone(size, generator)
    return replace(
        bar,
        edge=generator.uniform(0.3, 0.6),
        top=_dome(generator.uniform(0.05, 0.3) * size[2]),
        recess=generator.uniform(0.0008, 0.0015),
        recess_at=lambda x, _y: (x > -0.9).astype(float),
    )


def straight_remote(size: Size, generator: Generator) -> SlabShape:
    """A bar, its upper face flat or slightly domed."""
    bar = _remote(size, generator)
    return replace(bar, top=_dome(generator.uniform(0.0, 0.25) * size[2]))


def tapered_remote(size: Size, generator: Generator) -> SlabShape:
    """Narrower and thinner toward one end."""
    narrowing, thinning = generator.uniform(0.1, 0.4), generator.uniform(0.0, 0.4) * size[2]
    return replace(
        _remote(size, generator),
        width_at=lambda x: 1 - narrowing * (1 + x) / 2,
        top=lambda x, _y: -thinning * (1 + x) / 2,
    )


def waisted_remote(size: Size, generator: Generator) -> SlabShape:
    """Narrower in the middle, bulging below."""
    bar = _remote(size, generator)
    depth = generator.uniform(0.1, 0.35)
    bottom = _dome(-generator.uniform(0.1, 0.6) * size[2])
    return replace(bar, width_at=lambda x: 1 - depth * np.cos(np.pi * x / 2) ** 2, bottom=bottom)


def curved_remote(size: Size, generator: Generator) -> SlabShape:
    """Arched along its length."""
    arch = _arch(generator.uniform(0.2, 0.7) * size[2])
    return replace(_remote(size, generator), top=arch, bottom=arch)


def battery_remote(size: Size, generator: Generator) -> SlabShape:
    """A bar with a compartment that bulges below one end."""
    depth, start = generator.uniform(0.2, 0.5) * size[2], generator.uniform(-0.3, 0.3)
    return replace(_remote(size, generator), bottom=lambda x, _y: -depth * _smooth_step((start - x) / 0.3))


def plain_tablet(size: Size, generator: Generator) -> SlabShape:
    """A thin plate with rounded corners."""
    corner = generator.uniform(0.08, 0.2)
    edge = generator.uniform(0.4, 1.0)
    return SlabShape(size, corner=corner, corner_length=corner, edge=edge, cells=(20, 14))


def camera_tablet(size: Size, generator: Generator) -> SlabShape:
    """A thin plate with a raised camera block."""
    top, rows, columns = _camera(size, generator, extent=0.10)
    return replace(plain_tablet(size, generator), top=top, rows=rows, columns=columns)


def hardcover_book(size: Size, generator: Generator) -> SlabShape:
    """Covers that stand out over the pages on three sides; a flat spine on the fourth."""
    return SlabShape(
        size,
        corner=0.0,
        edge=generator.uniform(0.04, 0.08),
        recess=generator.uniform(0.002, 0.004),
        recess_at=lambda _x, y: (y > -0.999).astype(float),
        cells=(18, 12),
    )


def paperback_book(size: Size, generator: Generator) -> SlabShape:
    """A block with nearly sharp edges, sagging a little toward the spine."""
    sag = generator.uniform(0.0, 0.08) * size[2]
    return SlabShape(
        size, corner=0.0, edge=generator.uniform(0.04, 0.10), top=lambda _x, y: -sag * (1 - y) / 2, cells=(18, 12)
    )


def cardboard_box(size: Size, generator: Generator) -> SlabShape:
    """A block with nearly sharp edges."""
    return SlabShape(size, corner=0.0, edge=generator.uniform(0.03, 0.10), cells=(18, 12))


def rounded_box(size: Size, generator: Generator) -> SlabShape:
    """A block with rounded corners and edges."""
    corner = generator.uniform(0.1, 0.5)
    return SlabShape(size, corner=corner, corner_length=corner, edge=generator.uniform(0.1, 0.6), cells=(18, 12))


STYLES: dict[str, tuple[Style, ...]] = {
    "phone": (plain_phone, camera_phone, curved_phone, open_flip_phone, closed_flip_phone, camera_phone),
    "remote": (straight_remote, tapered_remote, waisted_remote, curved_remote, battery_remote),
    "tablet": (plain_tablet, camera_tablet),
    "book": (hardcover_book, paperback_book),
    "box": (cardboard_box, rounded_box),
}


def _remote(size: Size, generator: Generator) -> SlabShape:
    corner = generator.uniform(0.2, 0.7)
    corner_length = generator.uniform(0.6, 1.4) * corner
    return SlabShape(size, corner=corner, corner_length=corner_length, edge=generator.uniform(0.3, 1.0))


def _camera(
    size: Size, generator: Generator, *, extent: float = 0.2
) -> tuple[Heights, tuple[float, ...], tuple[float, ...]]:
    """A block near the end x = 0.8: heights and the grid lines at its walls."""
    height = generator.uniform(0.0010, 0.0025)
    half_x = generator.uniform(0.6, 1.0) * extent
    half_y = min(half_x * generator.uniform(0.7, 1.6) * size[0] / size[1], 0.6)
    wall_x, wall_y = 2 * 0.001 / size[0], 2 * 0.001 / size[1]
    centre_x = 0.78 - half_x - wall_x
    centre_y = generator.choice([-1.0, 0.0, 1.0]) * (0.8 - half_y - wall_y)

    def block(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        along = np.clip((half_x + wall_x - np.abs(x - centre_x)) / wall_x, 0, 1)
        across = np.clip((half_y + wall_y - np.abs(y - centre_y)) / wall_y, 0, 1)
        return height * np.minimum(along, across)

    rows = tuple(float(centre_x + s * half) for s in (-1, 1) for half in (half_x, half_x + wall_x))
    columns = tuple(float(centre_y + s * half) for s in (-1, 1) for half in (half_y, half_y + wall_y))
    return block, rows, columns


def _dome(height: float) -> Heights:
    return lambda x, y: height * (1 - y**2) * (1 - 0.5 * x**2)


def _arch(height: float) -> Heights:
    return lambda x, _y: height * (1 - x**2)


def _bend(height: float) -> Heights:
    return lambda x, _y: height * np.sqrt(x**2 + 0.02**2)


def _groove(height: float) -> Heights:
    return lambda x, _y: height * np.clip(1 - np.abs(x) / 0.06, 0, 1)


def _smooth_step(t: np.ndarray) -> np.ndarray:
    t = np.clip(t, 0, 1)
    return t**2 * (3 - 2 * t)
