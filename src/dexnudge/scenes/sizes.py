"""The sizes of a scene as understood, and the units that may have been meant instead."""

from __future__ import annotations

import trimesh

from dexnudge.finding import Finding, Level
from dexnudge.geometry.meshes import LONGEST_ENVIRONMENT, LONGEST_OBJECT, SHORTEST_OBJECT
from dexnudge.geometry.meshes import UNITS as METRES_PER_UNIT

ROOM = 12.0  # [m] longest side of surroundings that a hand works in; more is a hall, or another unit
SMALLEST_ENVIRONMENT = 0.1  # of the object's longest side: smaller surroundings are in another unit
KILOGRAM = 0.9995  # [kg] below it three digits of grams
HEAVIEST = 20e3  # [kg/m^3] platinum; a denser object has its mass in grams
LIGHTEST = 2.0  # [kg/m^3] a fifth of the lightest foam


def size_findings(object_mesh: trimesh.Trimesh, environment_mesh: trimesh.Trimesh, mass: float) -> list[Finding]:
    """Return both sizes [m] and the mass [kg] as understood; an error or a warning where they are not plausible."""
    size, room = object_mesh.extents, environment_mesh.extents
    length, width = float(size.max()), float(room.max())
    sides = " x ".join(f"{1e3 * side:.0f}" for side in size)
    around = " x ".join(f"{side:.2g}" for side in room)
    found = [
        Finding("note", "size", f"the object is {sides} mm, {_weight(mass)}"),
        Finding("note", "size", f"the surroundings are {around} m, {len(environment_mesh.faces)} triangles"),
    ]
    if not SHORTEST_OBJECT <= length <= LONGEST_OBJECT:
        sentence = f"the object is {length:.4g} m long; expected {SHORTEST_OBJECT:g} to {LONGEST_OBJECT:g} m"
        found.append(Finding("error", "units", sentence, _meant(length, SHORTEST_OBJECT, LONGEST_OBJECT)))
    elif width < SMALLEST_ENVIRONMENT * length:
        sentence = f"the surroundings are {width:.4g} m wide; expected more than the object, {length:.2g} m"
        found.append(Finding("error", "units", sentence, _meant(width, length, ROOM)))
    elif width > ROOM:
        level: Level = "error" if width > LONGEST_ENVIRONMENT else "warning"
        sentence = f"the surroundings are {width:.4g} m wide; expected at most {ROOM:g} m, as a room has"
        found.append(Finding(level, "units", sentence, _meant(width, length, ROOM)))
    density = mass / float(object_mesh.convex_hull.volume)
    if not LIGHTEST <= density <= HEAVIEST:
        sentence = f"the object weighs {mass:.3g} kg, {density:,.0f} kg/m^3; expected {LIGHTEST:g} to {HEAVIEST:g}"
        found.append(Finding("warning", "size", sentence, "give `mass` in kg"))
    return found


def _weight(mass: float) -> str:
    """Return a mass [kg] in the unit in which people would say it."""
    return f"{1e3 * mass:.3g} g" if mass < KILOGRAM else f"{mass:,.3g} kg" if mass < 1000 else f"{mass:,.0f} kg"


def _meant(metres: float, low: float, high: float) -> str:
    """Return the units in which a length is one from `low` to `high` [m], as a remedy."""
    lengths = {unit: metres * factor for unit, factor in METRES_PER_UNIT.items()}
    lengths |= {unit: metres / factor for unit, factor in METRES_PER_UNIT.items() if metres < low}
    fitting = [f"{unit} ({length:.3g} m)" for unit, length in lengths.items() if low <= length <= high and unit != "m"]
    return f"is it in another unit? pass `units` {' or '.join(fitting)}" if fitting else "scale it to metres"
