"""What sampling methods are called in reports."""

from collections.abc import Iterable

from dexnudge.experiments.markdown import markdown_table
from dexnudge.sampling.methods import METHODS

NAMES = {
    "steered_noise": "dexnudge",
    "resampled": "dexnudge, resampled",
    "guidance_only": "dexnudge, not projected",
    "grasp_projection": "dexnudge, asked for grasps",
    "coarse_hands": "coarse hands, descent + projection",
    "clean_descent": "descent on the clean estimate + projection",
    "best_of_32": "best of 32 coarse hands + projection",
    "unguided_projection": "prior + projection",
    "unguided": "prior alone",
    "paper": "Eq. 5 + projection",
    "paper_guidance_only": "Eq. 5, not projected",
    "spherical": "DSG + projection",
    "clean_gradient": "MPGD + projection",
    "random_start_projection": "random start + projection",
    "nearest_pose": "nearest training pose + projection",
}
"""Name in `METHODS` -> name in reports; one that is not here is called as in `METHODS`."""


def method_name(method: str) -> str:
    """What reports call a method."""
    return NAMES.get(method, method)


def method_table(methods: Iterable[str]) -> str:
    """Name in reports, name for `--method` and what it does, of each method once."""
    rows = [[method_name(method), f"`{method}`", METHODS[method].summary] for method in dict.fromkeys(methods)]
    return markdown_table(["name", "for `--method`", "what"], rows, names=3)
