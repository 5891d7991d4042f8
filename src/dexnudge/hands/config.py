"""What a URDF or MJCF cannot say about a hand: palm, fingertips, where the palm faces, joints that share a tendon.

It stands in a YAML beside the description, read without trust: small, plain, and with known keys only.
"""

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from jaxtyping import Float

from dexnudge.errors import HandError, InputError, is_name, quote
from dexnudge.jobs.json_files import Must, Name, from_fields

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


def read_yaml(path: Path, known: Sequence[str], *, robot: str, error: type[InputError]) -> dict[str, Any]:
    """Return what a YAML file says, by its keys.

    known: keys that it may have, and robot: what it describes, such as "hand", for messages.

    Raises:
        error: missing file, or not YAML.
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
        raise error(f"{path}: expected 'key: value' lines, got {type(raw).__name__}; write {', '.join(known)}")
    return raw


LONGEST_QUOTE = 200  # characters of a wrong value in a message
GEOMETRIES = ("collision", "visual")
Geometry = Annotated[str, Must(" or ".join(map(repr, GEOMETRIES)), GEOMETRIES.__contains__)]


def _are_names(value: Any) -> bool:
    """Whether a list of lists, or a mapping, holds pairs of names."""
    pairs = value.items() if isinstance(value, dict) else value
    return all(isinstance(pair, list | tuple) and len(pair) == 2 and all(map(is_name, pair)) for pair in pairs)


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


DIGITS = Must(
    "at least one line 'digit: link', names that look like numbers in quotes",
    lambda digits: bool(digits) and _are_names(digits),
)
DIRECTION = Must("three numbers [x, y, z], not all zero", lambda value: unit_direction(value) is not None)
COUPLINGS = Must("pairs of joints [follower, leader]", _are_names)


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

    palm: Name
    fingertips: Annotated[dict[str, str], DIGITS]
    palm_normal: Annotated[tuple[float, float, float], DIRECTION]
    couplings: Annotated[tuple[tuple[str, str], ...], COUPLINGS] = ()
    base_link: Name | None = None
    geometry: Geometry = "collision"
    name: Name | None = None


def read_hand_config(path: Path) -> HandConfig:
    """Return the configuration in a YAML file.

    Raises:
        HandError: missing file, not YAML, an unknown or missing key, or a value of another kind.
    """
    raw = read_yaml(path, ("palm", "fingertips", "palm_normal"), robot="hand", error=HandError)
    given = {key: value for key, value in raw.items() if value is not None}
    return from_fields(given, HandConfig, str(path), error=HandError, again="mend it")


KEYS_OF = {"hand.yaml": ("palm", "fingertips", "palm_normal"), "arm.yaml": ("flange", "home", "limits", "base")}


def yaml_beside(path: Path, other: str = "hand.yaml") -> Path | None:
    """Return the YAML beside a description file: `<stem>.yaml`, else the `other`; None without either.

    A `<stem>.yaml` of an arm is none of the hand that it carries, and the other way round.
    """
    own = path.with_suffix(".yaml")
    found = (file for file in (own, path.with_name(other)) if file.is_file())
    return next((file for file in found if file != own or not _is_of_another(own, other)), None)


def _is_of_another(path: Path, other: str) -> bool:
    """Whether the keys in a YAML are those of another kind of robot, and none are of this one."""
    with path.open(encoding="utf-8", errors="replace") as file:
        keys = set(re.findall(r"^(\w+)\s*:", file.read(MAX_CONFIG_BYTES), re.MULTILINE))
    kinds = {kind for kind, own in KEYS_OF.items() if keys & set(own)}
    return bool(kinds) and other not in kinds


def write_hand_config(config: HandConfig, path: Path) -> None:
    """Write what `read_hand_config` reads."""
    kept = {key: value for key, value in {"name": config.name, **asdict(config)}.items() if value is not None}
    path.write_text(yaml.safe_dump(kept, sort_keys=False, default_flow_style=None), encoding="utf-8")
