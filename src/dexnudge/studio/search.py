"""Drawing a few at a time, so that hands appear while others are still drawn."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from dexnudge.errors import SceneError
from dexnudge.results.samples import Samples
from dexnudge.sampling.methods import Method
from dexnudge.sampling.problem import prepare
from dexnudge.sampling.sampler import Sampler, call_seed
from dexnudge.scenes.scene import Scene
from dexnudge.verification.verdicts import Verdicts

AT_A_TIME = 8  # draws of one call
USER = "user"  # the name of scenes that no family drew


def draws(sampler: Sampler, scene: Scene, *, num: int, seed: int, method: Method) -> Iterator[Samples]:
    """Yield all samples so far, ranked, after every 8 draws until there are `num`; the first call draws 4.

    Raises:
        SceneError: nothing can be drawn in the scene; a line for each reason, such as a motion that is blocked.
        DexnudgeError: what `Sampler.sample` raises.
    """
    sampler.load(method)
    own = scene.name == USER or scene.turn is not None  # those of a family are built to be right
    findings = scene.findings(sampler.hand) if own else scene.misplaced
    if wrong := [finding.message for finding in findings if finding.level == "error"]:
        raise SceneError("\n".join(wrong))
    problem = prepare(scene)
    parts: list[Samples] = []
    drawn = 0
    while drawn < num:
        size = min(AT_A_TIME if parts else AT_A_TIME // 2, num - drawn)
        parts.append(
            sampler.sample(
                scene, num=size, seed=call_seed(seed, len(parts)), method=method, problem=problem, hand=sampler.hand
            )
        )
        drawn += size
        yield merged(parts)


def merged(parts: Sequence[Samples]) -> Samples:
    """Return the samples of several calls for one scene as those of one, ranked anew."""
    return replace(
        parts[0],
        q=np.concatenate([part.q for part in parts]),
        verdicts=Verdicts.concatenate([part.verdicts for part in parts]),
        own_rank=None,
        reports=tuple(report for part in parts for report in part.reports),
    ).best_first()
