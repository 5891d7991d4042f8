"""What the projection does to contacts and force margin: the same draws judged without it and with it."""

from dataclasses import replace
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
    """`figures` of the draws "before" and "after" the projection; nothing for a method without one.

    Draws `num` configurations twice from the same seed, which the projection does not touch, and judges all of them.
    """
    if method.projection is None:
        return {}
    problem = prepare(scene, device=sampler.device)
    stages = {"before": replace(method, projection=None), "after": method}
    drawn = {name: sampler.draw(problem, num=num, seed=seed, method=stage).q for name, stage in stages.items()}
    return {name: figures(verify(scene, hand, q)) for name, q in drawn.items()}


def figures(verdicts: Verdicts) -> dict[str, float | int]:
    """Verified draws, and means over all: links in contact, force margin, deepest of the three penetrations [mm].

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
