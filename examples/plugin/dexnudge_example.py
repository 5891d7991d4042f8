"""A scene family, an arm, a term and a criterion of one's own: a slippery table, a slow arm, a palm that keeps away."""

from dataclasses import dataclass, replace

import numpy as np
import torch
import trimesh

import dexnudge as dn

LEAST = 0.06  # [m] of the palm over the object's origin


def ice(mesh: trimesh.Trimesh, generator: np.random.Generator) -> dn.Scene:
    """Return a table as slippery as ice."""
    table = dn.build_scene("table", mesh, seed=int(generator.integers(2**31)))
    return replace(table, name="ice", friction_environment=0.05)


def careful_panda() -> dn.Arm:
    """Return Franka's Panda at a third of its speed."""
    arm = dn.load_arm("panda")
    return replace(arm, name="careful_panda", limits=replace(arm.limits, velocity=arm.limits.velocity / 3))


def height(hands: dn.HandBatch, scene: dn.Scene) -> torch.Tensor:
    """Return how high each palm is over the object's origin [m]."""
    return hands.T_world_link[:, 0, 2, 3] - float(scene.T_world_object[2, 3])


@dataclass
class HighPalm:
    """E = max(0, LEAST - height)^2 [m^2]."""

    name: str = "high_palm"
    weight: float = 1.0

    def __call__(self, hands: dn.HandBatch, scene: dn.Scene) -> torch.Tensor:
        """Return the energy of each hand."""
        return (LEAST - height(hands, scene)).clamp_min(0.0).square()


class PalmHeight:
    """The palm is at least LEAST over the object."""

    name = "palm_height"

    def __call__(self, hands: dn.HandBatch, scene: dn.Scene) -> dn.CriterionResult:
        """Judge each hand."""
        found = height(hands, scene)
        return dn.CriterionResult(found, found >= LEAST, "the palm is too low; add the term high_palm, or its weight")
