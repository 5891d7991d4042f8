"""Intervals for rates: the objects are the sample, not the draws."""

import numpy as np
from jaxtyping import Float

from dexnudge.errors import InputError

RESAMPLES = 4000
"""Bootstrap samples: the ends of a 95 % interval then repeat to about a hundredth of its width."""


def bootstrap_interval(
    values: Float[np.ndarray, " object"], *, level: float = 0.95, seed: int = 0, resamples: int = RESAMPLES
) -> tuple[float, float]:
    """Return the percentile bootstrap interval of the mean over objects.

    values: one number per attempted object, a failed one included as 0: the share of its draws that succeed (rate over
    all samples), or 0/1 for its top-ranked draw or for any of its n. Draws of one object are not independent, so whole
    objects are resampled. With one object, or equal values, the interval has no width: it then says nothing about
    unseen objects.

    Raises:
        InputError: no values, a value that is not finite, or a level outside (0, 1).
    """
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 1 or len(values) == 0 or not np.isfinite(values).all():
        raise InputError(f"an interval needs one finite value per object; got an array of shape {values.shape}")
    if not 0.0 < level < 1.0:
        raise InputError(f"the level of an interval is {level}; expected a number between 0 and 1, such as 0.95")
    draws = np.random.default_rng(seed).integers(0, len(values), size=(resamples, len(values)))
    low, high = np.quantile(values[draws].mean(axis=1), [(1.0 - level) / 2.0, (1.0 + level) / 2.0])
    return float(low), float(high)
