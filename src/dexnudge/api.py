"""The Python interface: everything that a script needs, from one place.

hand = load_hand("shadow_lite")
scene = build_scene("table", builtin_object("phone"), seed=0)
samples = Sampler(hand).sample(scene, num=32)
print(samples.num_verified, samples.q[0])  # the best configuration: root translation, 6D rotation, joint angles
"""

from dexnudge.errors import DexnudgeError
from dexnudge.geometry.meshes import load_environment, load_mesh
from dexnudge.hands.export import export_hand
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.objects.builtin import builtin_names, builtin_object
from dexnudge.results.checking import Check, check
from dexnudge.results.samples import Sample, Samples, load_samples
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import SCENE_FAMILIES, build_scene
from dexnudge.scenes.scene import Scene
from dexnudge.verification.verdicts import Verdicts, verify

__all__ = [
    "SCENE_FAMILIES",
    "Check",
    "DexnudgeError",
    "Hand",
    "Sample",
    "Sampler",
    "Samples",
    "Scene",
    "Verdicts",
    "build_scene",
    "builtin_names",
    "builtin_object",
    "check",
    "export_hand",
    "load_environment",
    "load_hand",
    "load_mesh",
    "load_samples",
    "verify",
]
