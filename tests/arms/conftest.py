"""A folder with a description and the YAML beside it."""

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml


@pytest.fixture
def described(tmp_path: Path) -> Callable[..., Path]:
    """Write a description, and the YAML beside it where one is given; return its path."""

    def write(text: str, facts: dict | str | None = None, *, name: str = "six.urdf", beside: str | None = None) -> Path:
        path = tmp_path / name
        path.write_text(text)
        if facts is not None:
            content = facts if isinstance(facts, str) else yaml.safe_dump(facts, sort_keys=False)
            (tmp_path / (beside or path.with_suffix(".yaml").name)).write_text(content)
        return path

    return write
