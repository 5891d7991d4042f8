"""dexnudge: hand configurations that push, press or hook what a hand cannot grasp.

import dexnudge as dn

hand = dn.load_hand("shadow_lite")
scene = dn.build_scene("shelf", "phone", seed=0)
samples = dn.Sampler(hand).sample(scene, num=32, seed=0)
print(samples)
samples.save("out")

The public names stand in `__init__.pyi`; their modules are imported when one of them is first used.

Torch reads from the environment, as it is imported, how many threads it takes and how idle ones wait; importing dexnudge
before it sets both, unless the user has.
"""

import ast
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from dexnudge.jobs.processes import limit_threads as _limit_threads

_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
_MODULES = {name.name: each.module for each in _STUB.body if isinstance(each, ast.ImportFrom) for name in each.names}

__all__ = list(_MODULES)

if "torch" not in sys.modules:
    _limit_threads()


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_MODULES[name]), name)
    return value


def __dir__() -> list[str]:
    return __all__
