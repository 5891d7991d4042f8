"""Which draws are listed, and what is said of one."""

import numpy as np
from jaxtyping import Int

from dexnudge.results.samples import NOT_ON_PAGE, Sample, Samples
from dexnudge.studio.layers import Layers

MOST_AT_ONCE = 32  # hands that are shown together
ALL, VERIFIED = "all", "verified"


def listed(samples: Samples) -> dict[str, Int[np.ndarray, " m"]]:
    """Return the places of the draws by what they have in common, best first: all, verified, each reason of failure."""
    reasons = np.array(samples.reasons)
    found = {ALL: np.arange(len(samples)), VERIFIED: np.flatnonzero(samples.success)}
    found |= {reason: np.flatnonzero(reasons == reason) for reason in samples.rejections()}
    return {f"{name} ({len(places)})": places for name, places in found.items() if len(places)}


def figures(sample: Sample, rank: int, layers: Layers, *, sentence: str = "") -> dict[str, str]:
    """Return what is said of a draw, by name; `sentence` tells what its failure means."""
    rows = {"rank": str(rank + 1), "verdict": "verified" if sample.success else f"rejected: {sample.reason}"}
    if sentence:
        rows["which means"] = sentence
    for name, value in sample.values.items():
        if name in NOT_ON_PAGE or np.isnan(value):
            continue
        depth = name.startswith("penetration_")
        rows[name.replace("_", " ")] = f"{1e3 * value:.2f} mm" if depth else f"{value:.3g}"
    for name, value in sample.foresight.items():
        if not np.isnan(value):
            rows[name.replace("_", " ")] = f"{value:.0%}"
    rows["touches with"] = ", ".join(sample.contact_links) or "nothing"
    if layers.balanced:
        rows["presses with"] = f"{layers.pressed:.1f} N in all"
    nearest = int(np.argmin(layers.clearance))
    if np.isfinite(layers.clearance[nearest]):
        rows["clearance"] = f"{1e3 * layers.clearance[nearest]:.1f} mm, {sample.hand.link_names[nearest]}"
    return rows
