"""What a URDF or MJCF cannot say about a hand: palm, fingertips, where the palm faces, joints that share a tendon."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float

from dexnudge.errors import HandError, is_name
from dexnudge.hands.yaml_text import read_yaml

LONGEST_QUOTE = 200  # characters of a wrong value in a message
GEOMETRIES = ("collision", "visual")


@dataclass(frozen=True)
class HandConfig:
    """Facts that stand beside a robot description.

    Attributes:
        palm: link that becomes the root; its pose is the first nine numbers of q.
        fingertips: digit name -> last link of that digit.
        palm_normal: direction in which the palm faces, palm frame; any length.
        couplings: (follower, leader) joints with the hard constraint angle(follower) <= angle(leader).
        base_link: forearm or adapter behind the palm; left out with `base=False`.
        geometry: which of the description's geometry is judged, "collision" or "visual".
        name: the hand's name; None: the description's own.
    """

    palm: str
    fingertips: dict[str, str]
    palm_normal: tuple[float, float, float]
    couplings: tuple[tuple[str, str], ...] = field(default=())
    base_link: str | None = None
    geometry: str = "collision"
    name: str | None = None


def read_hand_config(path: Path) -> HandConfig:
    """Return the configuration in a YAML file.

    Raises:
        HandError: missing file, not YAML, an unknown or missing key, or a value of another kind.
    """
    known = [f.name for f in fields(HandConfig)]
    raw = read_yaml(path, known, robot="hand", needed=("palm", "fingertips", "palm_normal"), error=HandError)
    return HandConfig(
        palm=_text(raw["palm"], "palm", path),
        fingertips=_fingertips(raw["fingertips"], path),
        palm_normal=_direction(raw["palm_normal"], path),
        couplings=_couplings(raw.get("couplings") or [], path),
        base_link=_optional_text(raw.get("base_link"), "base_link", path),
        geometry=_geometry(raw.get("geometry", "collision"), path),
        name=_optional_text(raw.get("name"), "name", path),
    )


def yaml_beside(path: Path, other: str = "hand.yaml") -> Path | None:
    """Return the YAML beside a description file: `<stem>.yaml`, else the `other`; None without either."""
    found = (file for file in (path.with_suffix(".yaml"), path.with_name(other)) if file.is_file())
    return next(found, None)


def write_hand_config(config: HandConfig, path: Path) -> None:
    """Write what `read_hand_config` reads."""
    raw = {
        "name": config.name,
        "palm": config.palm,
        "fingertips": dict(config.fingertips),
        "palm_normal": [float(value) for value in config.palm_normal],
        "couplings": [list(pair) for pair in config.couplings],
        "base_link": config.base_link,
        "geometry": config.geometry,
    }
    kept = {key: value for key, value in raw.items() if value is not None}
    path.write_text(yaml.safe_dump(kept, sort_keys=False, default_flow_style=None), encoding="utf-8")


def _wrong(path: Path, key: str, expected: str, got: Any) -> HandError:
    return HandError(f"{path}: key '{key}': expected {expected}, got {repr(got)[:LONGEST_QUOTE]}; mend it")


def _text(value: Any, key: str, path: Path) -> str:
    if not is_name(value):
        raise _wrong(path, key, "a name", value)
    return str(value)


def _optional_text(value: Any, key: str, path: Path) -> str | None:
    return None if value is None else _text(value, key, path)


def _fingertips(value: Any, path: Path) -> dict[str, str]:
    valid = isinstance(value, dict) and value and all(is_name(v) for pair in value.items() for v in pair)
    if not valid:
        numbered = isinstance(value, dict) and value and not any(isinstance(v, list | dict) for v in value.values())
        hint = ", names that look like numbers in quotes" if numbered else ""
        raise _wrong(path, "fingertips", f"at least one line 'digit: link'{hint}", value)
    return dict(value)


def _direction(value: Any, path: Path) -> tuple[float, float, float]:
    expected = "three numbers [x, y, z], not all zero"
    if not isinstance(value, list) or len(value) != 3 or not all(type(v) in (int, float) for v in value):
        raise _wrong(path, "palm_normal", expected, value)
    if unit_direction(value) is None:
        raise _wrong(path, "palm_normal", expected, value)
    return (float(value[0]), float(value[1]), float(value[2]))


def unit_direction(value: Any) -> Float[np.ndarray, " 3"] | None:
    """Return three numbers as a unit vector; None where they are none, not finite, or all zero."""
    try:
        vector = np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return None
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        return None
    vector = vector / np.abs(vector).max()  # the squares of large and small numbers leave the range of numbers
    return np.asarray(vector / np.linalg.norm(vector))


def _couplings(value: Any, path: Path) -> tuple[tuple[str, str], ...]:
    if not isinstance(value, list):
        raise _wrong(path, "couplings", "pairs of joints [follower, leader]", value)
    for pair in value:
        if not isinstance(pair, list) or len(pair) != 2 or not all(is_name(name) for name in pair):
            raise _wrong(path, "couplings", "pairs of joints [follower, leader]", pair)
    return tuple((pair[0], pair[1]) for pair in value)


def _geometry(value: Any, path: Path) -> str:
    if value not in GEOMETRIES:
        raise _wrong(path, "geometry", f"one of {list(GEOMETRIES)}", value)
    return str(value)
