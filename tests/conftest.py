"""Shape and type checks on every call into dexnudge, and settings that all tests share."""

import os
import re
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

SOURCE = Path(__file__).parents[1] / "src"
# Warp compiles the source of a kernel as it stands, so nothing may be wrapped around it, and its structs are no types
# that could be checked; a name that is imported for the type checker alone cannot be looked up when the program runs.
UNCHECKABLE = re.compile(r"^@wp\.(kernel|func|struct)|^from \S+_kernel import|^if TYPE_CHECKING:", re.MULTILINE)


def checkable_modules() -> list[str]:
    """Names of the modules whose annotations can be checked while they run."""
    files = sorted(file for file in (SOURCE / "dexnudge").rglob("*.py") if file.name != "__init__.py")
    checkable = [file for file in files if not UNCHECKABLE.search(file.read_text(encoding="utf-8"))]
    return [".".join(file.relative_to(SOURCE).with_suffix("").parts) for file in checkable]


# Tests neither read nor write what the developer's own runs have cached; commands that they start inherit this.
os.environ["DEXNUDGE_CACHE"] = "off"

# Before any test module imports dexnudge.
install_import_hook(checkable_modules(), "beartype.beartype")


@pytest.fixture(scope="session", autouse=True)
def one_torch_thread_per_worker(request: pytest.FixtureRequest) -> None:
    """Workers share the cores; more threads than cores would only wait for each other."""
    if hasattr(request.config, "workerinput"):
        import torch

        torch.set_num_threads(1)
