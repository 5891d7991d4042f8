"""Energy terms, their weights, and the fused kernel that evaluates them with their gradient."""

from dexnudge.energies.evaluator import HandEnergy, HandPose
from dexnudge.energies.scene_fields import build_scene_fields
from dexnudge.energies.terms import TermWeights

__all__ = ["HandEnergy", "HandPose", "TermWeights", "build_scene_fields"]
