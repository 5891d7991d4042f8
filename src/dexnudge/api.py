"""The Python interface: everything that a script needs, from one place.

hand = load_hand("shadow_lite")
scene = build_scene("table", builtin_object("phone"), seed=0)
sampler = Sampler.from_pretrained(hand)
draws = draw_and_judge(sampler, hand, scene, num=32)
print(draws.num_verified, draws.q[0])  # the best configuration: root translation, 6D rotation, joint angles
"""

from dexnudge.errors import DexnudgeError
from dexnudge.geometry.meshes import load_environment, load_mesh
from dexnudge.hands.export import export_hand
from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand
from dexnudge.objects.builtin import builtin_names, builtin_object
from dexnudge.results.checking import Check, check_folder
from dexnudge.results.samples import Samples
from dexnudge.sampling.draws import draw_and_judge
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import SCENE_FAMILIES, build_scene
from dexnudge.scenes.scene import Scene
from dexnudge.verification.verdicts import Verdicts, verify

__all__ = [
    "SCENE_FAMILIES",
    "Check",
    "DexnudgeError",
    "Hand",
    "Sampler",
    "Samples",
    "Scene",
    "Verdicts",
    "build_scene",
    "builtin_names",
    "builtin_object",
    "check_folder",
    "draw_and_judge",
    "export_hand",
    "load_environment",
    "load_hand",
    "load_mesh",
    "verify",
]
