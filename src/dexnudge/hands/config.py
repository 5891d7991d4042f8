"""What a URDF or MJCF cannot say about a hand: palm, fingertips, where the palm faces, joints that share a tendon.

It stands in a YAML beside the description, read without trust: small, plain, and with known keys only.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float

from dexnudge.errors import HandError, InputError, is_name, quote

MAX_CONFIG_BYTES = 100_000
MAX_DEPTH = 10  # of lists and mappings; three are in use


class _Loader(yaml.SafeLoader):
    """Refuses a key that stands twice, of which YAML would keep the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:  # noqa: FBT001, FBT002
        found = super().construct_mapping(node, deep=deep)
        if len(found) < len(node.value):
            keys = [key.value for key, _ in node.value]
            twice = next((key for key in keys if keys.count(key) > 1), keys[0])
            raise yaml.YAMLError(f"the key {quote(twice)} twice")
        return found


def read_yaml(
    path: Path, known: Sequence[str], *, robot: str, needed: Sequence[str], error: type[InputError]
) -> dict[str, Any]:
    """Return what a YAML file says, by its keys.

    Args:
        path: the file.
        known: the keys that it may have.
        robot: what it describes, such as "hand", for messages.
        needed: the keys that it must have.
        error: class of what is raised.

    Raises:
        error: missing file, not YAML, or an unknown or missing key.
    """
    if not path.is_file():
        raise error(f"the {robot}'s YAML is missing: expected a file at {path}, found none; mend the path")
    if path.stat().st_size > MAX_CONFIG_BYTES:
        raise error(
            f"{path}: the file is too large: expected at most {MAX_CONFIG_BYTES} bytes, got {path.stat().st_size}; "
            f"keep only the {robot}'s own keys"
        )
    try:
        text = path.read_text(encoding="utf-8")
        depth = 0
        for event in yaml.parse(text):  # before anything is made of it: aliases can stand for gigabytes
            if isinstance(event, yaml.AliasEvent):
                raise error(f"{path}: YAML aliases are not read: expected plain values, got '*'; write them out")
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                raise error(f"{path}: expected lists in lists {MAX_DEPTH} deep at most, got more; write plain values")
        raw = yaml.load(text, _Loader)  # noqa: S506 - a SafeLoader
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as fault:
        if isinstance(fault, InputError):
            raise
        summary = " ".join(str(fault).split())
        raise error(f"{path}: not a YAML file: expected 'key: value' lines, got '{summary}'; mend the file") from fault
    if not isinstance(raw, dict):
        raise error(
            f"{path}: expected 'key: value' lines, got {type(raw).__name__}; write {', '.join(needed or known)}"
        )
    unknown = [key for key in raw if key not in known]
    if unknown:
        raise error(f"{path}: unknown keys {quote(unknown)}; expected some of {list(known)}; remove or rename them")
    missing = [key for key in needed if key not in raw]
    if missing:
        wanted = f"{', '.join(needed[:-1])} and {needed[-1]}" if len(needed) > 1 else needed[0]
        raise error(f"{path}: missing keys {missing}; expected {wanted}; add them")
    return raw


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
