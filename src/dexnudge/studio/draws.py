"""Draws made a few at a time, so that hands appear while others are still drawn; their list, and what is said of one."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Int

from dexnudge.errors import SceneError
from dexnudge.finding import probability_text
from dexnudge.results.samples import NOT_ON_PAGE, Sample, Samples
from dexnudge.sampling.methods import Method
from dexnudge.sampling.problem import prepare
from dexnudge.sampling.sampler import Sampler, call_seed
from dexnudge.scenes.scene import Scene
from dexnudge.studio.views import Layers
from dexnudge.verification.verdicts import Verdicts

MOST_AT_ONCE = 32  # hands that are shown together
MOST_DRAWS = 512  # of one click
ALL, VERIFIED = "all", "verified"
DIGITS = {"force_margin": ".2f"}  # of values, in place of three that count


def listed(samples: Samples) -> dict[str, Int[np.ndarray, " m"]]:
    """Return the places of the draws by what they have in common, best first: all, verified, each reason of failure."""
    reasons = np.array(samples.reasons)
    found = {ALL: np.arange(len(samples)), VERIFIED: np.flatnonzero(samples.success)}
    found |= {reason: np.flatnonzero(reasons == reason) for reason in samples.rejections()}
    return {f"{name} ({len(places)})": places for name, places in found.items() if len(places)}


def figures(sample: Sample, number: int, layers: Layers, *, sentence: str = "") -> dict[str, str]:
    """Return what is said of a draw, by name; `number` is that of the files, `sentence` tells what its failure means."""
    rows = {"configuration": str(number), "verdict": "verified" if sample.success else f"rejected: {sample.reason}"}
    if sentence:
        rows["which means"] = sentence
    for name, value in sample.values.items():
        if name in NOT_ON_PAGE or np.isnan(value):
            continue
        depth = name.startswith("penetration_")
        rows[name.replace("_", " ")] = f"{1e3 * value:.2f} mm" if depth else f"{value:{DIGITS.get(name, '.3g')}}"
    for name, value in sample.calibrated.items():
        if not np.isnan(value):
            rows[name.replace("_", " ")] = probability_text(value) if name == "probability" else f"{value:.0%}"
    rows["touches with"] = ", ".join(sample.contact_links) or "nothing"
    if layers.balanced:
        rows["presses with"] = f"{layers.pressed:.1f} N in all"
    nearest = int(np.argmin(layers.clearance))
    if np.isfinite(layers.clearance[nearest]):
        rows["clearance"] = f"{1e3 * layers.clearance[nearest]:.1f} mm, {sample.hand.link_names[nearest]}"
    return rows


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
    problem = prepare(scene, device=sampler.device)
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
