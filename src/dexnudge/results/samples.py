"""The draws for a scene, each with its verdict."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dexnudge.verification.verdicts import Verdicts


@dataclass(frozen=True)
class Samples:
    """Every draw with its verdict, verified ones first, best first.

    `own_rank` is the place that the sampler itself gave each draw, before anything was verified. `seconds` by stage;
    `reports`, the sampler's own, one for each call.
    """

    q: Float[np.ndarray, "n coordinates"]
    verdicts: Verdicts
    own_rank: Int[np.ndarray, " n"]
    seconds: dict[str, float]
    reports: tuple[dict[str, Any], ...]

    @property
    def num_verified(self) -> int:
        """How many draws succeed."""
        return int(self.verdicts.success.sum())

    def rejections(self) -> dict[str, int]:
        """Rejected draws by reason, most frequent first."""
        reasons = (r for r, ok in zip(self.verdicts.reason, self.verdicts.success, strict=True) if not ok)
        return dict(Counter(reasons).most_common())
