"""dexnudge: hand configurations that push, press or hook what a hand cannot grasp.

import dexnudge as dn

hand = dn.load_hand("shadow_lite")
scene = dn.build_scene("shelf", "phone", seed=0)
samples = dn.Sampler(hand).sample(scene, num=32, seed=0)
print(samples)
samples.save("out")

Modules are imported when one of their names is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dexnudge.energies.terms import EnergyTerm, find_term
    from dexnudge.errors import (
        CheckpointError,
        DatasetError,
        DexnudgeError,
        HandError,
        InputError,
        MeshError,
        OutputError,
        SceneError,
        UnknownNameError,
    )
    from dexnudge.execution.episode import Episode, execute
    from dexnudge.geometry.meshes import load_environment, load_mesh
    from dexnudge.hands.batch import HandBatch
    from dexnudge.hands.export import export_hand
    from dexnudge.hands.hand import Hand
    from dexnudge.hands.registry import load_hand
    from dexnudge.objects.builtin import builtin_names, builtin_object
    from dexnudge.planning.outcomes import Outcome
    from dexnudge.results.checking import Check, check
    from dexnudge.results.samples import Sample, Samples, load_samples
    from dexnudge.sampling.sampler import Sampler
    from dexnudge.scenes.families import build_scene, scene_families
    from dexnudge.scenes.scene import Scene, load_scene
    from dexnudge.verification.criteria import Criterion, CriterionResult, default_criteria, find_criterion
    from dexnudge.verification.measurements import Measurements, measure
    from dexnudge.verification.verdicts import Verdicts, verify

__version__ = "0.7.0"

__all__ = [
    "Check",
    "CheckpointError",
    "Criterion",
    "CriterionResult",
    "DatasetError",
    "DexnudgeError",
    "EnergyTerm",
    "Episode",
    "Hand",
    "HandBatch",
    "HandError",
    "InputError",
    "Measurements",
    "MeshError",
    "Outcome",
    "OutputError",
    "Sample",
    "Sampler",
    "Samples",
    "Scene",
    "SceneError",
    "UnknownNameError",
    "Verdicts",
    "__version__",
    "build_scene",
    "builtin_names",
    "builtin_object",
    "check",
    "default_criteria",
    "execute",
    "export_hand",
    "find_criterion",
    "find_term",
    "load_environment",
    "load_hand",
    "load_mesh",
    "load_samples",
    "load_scene",
    "measure",
    "scene_families",
    "verify",
]

_MODULES = {
    "errors": (
        "CheckpointError",
        "DatasetError",
        "DexnudgeError",
        "HandError",
        "InputError",
        "MeshError",
        "OutputError",
        "SceneError",
        "UnknownNameError",
    ),
    "execution.episode": ("Episode", "execute"),
    "geometry.meshes": ("load_environment", "load_mesh"),
    "hands.batch": ("HandBatch",),
    "hands.export": ("export_hand",),
    "hands.hand": ("Hand",),
    "hands.registry": ("load_hand",),
    "objects.builtin": ("builtin_names", "builtin_object"),
    "planning.outcomes": ("Outcome",),
    "results.checking": ("Check", "check"),
    "results.samples": ("Sample", "Samples", "load_samples"),
    "sampling.sampler": ("Sampler",),
    "scenes.families": ("build_scene", "scene_families"),
    "scenes.scene": ("Scene", "load_scene"),
    "energies.terms": ("EnergyTerm", "find_term"),
    "verification.criteria": ("Criterion", "CriterionResult", "default_criteria", "find_criterion"),
    "verification.measurements": ("Measurements", "measure"),
    "verification.verdicts": ("Verdicts", "verify"),
}


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            value = getattr(import_module(f"{__name__}.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
