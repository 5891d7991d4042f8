"""The built-in objects: phones, remotes, tablets, books and boxes, closed and metric, made from their names alone.

Object frame: x = length, y = width, z = thickness, origin at the centre of the bounding box.
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass

import numpy as np
import trimesh

from dexnudge.errors import UnknownNameError, check_kind
from dexnudge.objects.slab import SlabShape, slab_mesh
from dexnudge.objects.styles import STYLES, camera_phone, cardboard_box, hardcover_book, plain_tablet, waisted_remote

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
    """Return whether a cell of the plane of proportions belongs to the test set."""
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


def _thickness_range(kind: str, width_ratio: float) -> tuple[float, float]:
    low, high = KINDS[kind].thickness_ratio
    return low, min(high, FLATNESS * width_ratio)


def _between(limits: tuple[float, float], fraction: float) -> float:
    return float(limits[0] + fraction * (limits[1] - limits[0]))


TRAIN_COUNTS = {"phone": 96, "remote": 112, "tablet": 32, "book": 32, "box": 48}
TEST_COUNTS = {"phone": 14, "remote": 16, "tablet": 4, "book": 4, "box": 4}
FIRST_TEST_NUMBER = 200  # phone-000.. are for training, phone-200.. for testing

# The plain names: a common object of each kind, for demonstrations. Sizes in metres, as on the makers' data sheets
# of a current phone, a television remote, a small tablet, a hardback in octavo and a shoe-care box.
PLAIN = {
    "phone": (camera_phone, (0.150, 0.072, 0.0100)),
    "remote": (waisted_remote, (0.180, 0.045, 0.0220)),
    "tablet": (plain_tablet, (0.200, 0.134, 0.0085)),
    "book": (hardcover_book, (0.215, 0.140, 0.0250)),
    "box": (cardboard_box, (0.160, 0.090, 0.0350)),
}


def builtin_names(set_name: str) -> list[str]:
    """Return the names of a set: "train" (320 objects) or "test" (42, with proportions that no training object has).

    Raises:
        UnknownNameError: another set name.
    """
    counts = {"train": (TRAIN_COUNTS, 0), "test": (TEST_COUNTS, FIRST_TEST_NUMBER)}
    if set_name not in counts:
        raise UnknownNameError(f"unknown built-in set {set_name!r}; expected builtin:train or builtin:test")
    per_kind, first = counts[set_name]
    return [f"{kind}-{first + k:03d}" for kind, count in per_kind.items() for k in range(count)]


def is_builtin(name: str) -> bool:
    """Return whether `builtin_object` knows the name."""
    if name in PLAIN:
        return True
    match = re.fullmatch(r"([a-z]+)-(\d{3})", name)
    if match is None or match[1] not in TRAIN_COUNTS:
        return False
    number = int(match[2])
    return number < TRAIN_COUNTS[match[1]] or 0 <= number - FIRST_TEST_NUMBER < TEST_COUNTS[match[1]]


def builtin_shape(name: str) -> SlabShape:
    """Return the parameters behind a built-in name; the name is the seed.

    Raises:
        UnknownNameError: no such object; the message lists those that exist.
    """
    check_kind("name", name, str, "'phone'")
    if not is_builtin(name):
        raise UnknownNameError(f"unknown built-in object {name!r}; expected {describe_builtin_names()}")
    kind, _, number = name.partition("-")
    generator = np.random.default_rng(zlib.crc32(name.encode()))
    if not number:
        style, size = PLAIN[kind]
        return style(size, generator)
    size = draw_size(kind, generator, test=int(number) >= FIRST_TEST_NUMBER)
    styles = STYLES[kind]
    return styles[int(number) % len(styles)](size, generator)


def builtin_object(name: str) -> trimesh.Trimesh:
    """Return the mesh [m] of a built-in object such as "phone", "phone-017" or "remote-203".

    Raises:
        UnknownNameError: no such object; the message lists those that exist.
    """
    mesh = slab_mesh(builtin_shape(name))
    mesh.metadata["name"] = name
    return mesh


def describe_builtin_names() -> str:
    """Return all built-in names in one line."""
    ranges = [
        f"{kind}-000..{count - 1:03d} and {kind}-{FIRST_TEST_NUMBER}..{FIRST_TEST_NUMBER + TEST_COUNTS[kind] - 1}"
        for kind, count in TRAIN_COUNTS.items()
    ]
    return f"{', '.join(PLAIN)}, {', '.join(ranges)}"
