"""What to say when no draw is verified: the reason that most of them failed for, and what could be done about it."""

from typing import Any

BLOCKED = "motion blocked"
ADVICE = {
    "invalid": "the sampler gave no poses; check the model that --weights names",
    "joint limits": "the hand would have to bend beyond its limits; check the limits and couplings of --hand",
    "penetration environment": "there is hardly room for the hand; make some, try --no-base, or draw more (--num)",
    "penetration object": "the hand cannot close in without entering the object; draw more (--num)",
    "penetration self": "the fingers get into each other's way; draw more (--num)",
    "no contact": "the hand does not reach the object; check that something of it is exposed",
    BLOCKED: "the surroundings stand in the object's way; choose another motion, or mend its pose",
    "force": (
        "contacts were found, but no forces that move the object; raise --friction-hand or --max-normal-force, "
        "lower --friction-environment or --mass, or draw more (--num)"
    ),
}
"""By the reasons of `evaluation.success.Verdicts`."""


def nothing_verified(summary: dict[str, Any]) -> str:
    """One sentence for a summary without verified draws; `rejected` stands in order, most frequent first.

    A blocked motion is a property of the scene, so one draw that got as far as to fail for it speaks for all.
    """
    rejected = summary["rejected"]
    reason, count = next(iter(rejected.items()))
    said = f"none of {summary['drawn']} draws is verified; {count} of them failed for '{reason}': {ADVICE[reason]}"
    if reason != BLOCKED and BLOCKED in rejected:
        return f"{said}; and no hand can help it: {ADVICE[BLOCKED]}"
    return said
