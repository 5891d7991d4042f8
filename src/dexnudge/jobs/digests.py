"""A checksum inside the JSON that it is of: what has changed in a file that a run relies on is told, not followed."""

import json
from hashlib import sha256
from typing import Any

KEY = "sha256"  # of the other fields; files from before 0.20.0, and shards from before 0.19.0, have none


def signed(content: dict[str, Any]) -> dict[str, Any]:
    """Return the object with its checksum."""
    return content | {KEY: digest(content)}


def is_as_signed(content: dict[str, Any]) -> bool:
    """Whether the object is what its checksum is of; one without is taken as it is."""
    return content.get(KEY) in (None, digest({key: value for key, value in content.items() if key != KEY}))


def digest(content: dict[str, Any]) -> str:
    """Return the SHA-256 of what JSON makes of an object, whatever the order of its keys."""
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
