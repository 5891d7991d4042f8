"""The YAML beside a robot description, read without trust: small, plain, and with known keys only."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from dexnudge.errors import InputError, quote

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
