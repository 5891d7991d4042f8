"""The made-up dataset of `toy.py`."""

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def toy() -> ModuleType:
    """Module that writes made-up datasets."""
    spec = importlib.util.spec_from_file_location("toy", Path(__file__).with_name("toy.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def toy_folder(toy: ModuleType, tmp_path: Path) -> Path:
    """A dataset of three objects with twelve rows each."""
    toy.write_toy_dataset(tmp_path)
    return tmp_path
