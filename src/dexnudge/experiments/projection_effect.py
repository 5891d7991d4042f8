"""What the projection does to contacts and force margin: the same draws verified before it and after it."""

from typing import Any

import numpy as np

from dexnudge.hands.hand import Hand
from dexnudge.sampling.methods import Method
from dexnudge.sampling.problem import prepare
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.verification.verdicts import Verdicts, verify


def projection_effect(
    sampler: Sampler, hand: Hand, scene: Scene, *, num: int, seed: int, method: Method
) -> dict[str, dict[str, float | int]]:
    """Return `figures` of `num` draws "before" and "after" the projection; nothing for a method without one."""
    if method.projection is None:
        return {}
    draws = sampler.draw(prepare(scene, device=sampler.device), num=num, seed=seed, method=method)
    stages = {"before": draws.unprojected, "after": draws.q}
    return {name: figures(verify(scene, hand, q)) for name, q in stages.items()}


def figures(verdicts: Verdicts) -> dict[str, float | int]:
    """Return how many are verified, and means over all: links in contact, force margin, deepest penetration [mm].

    A hand that stands in the object touches it all around, so its margin says little: read it with the penetration.
    """
    deepest: Any = verdicts.deepest_penetration
    return {
        "verified": int(verdicts.success.sum()),
        "contact_links": float(np.mean([len(links) for links in verdicts.contact_links])),
        "force_margin": float(verdicts.force_margin.mean()),
        "force_margin_median": float(np.median(verdicts.force_margin)),
        "penetration_mm": 1e3 * float(np.nanmean(deepest)) if np.isfinite(deepest).any() else 0.0,
    }
