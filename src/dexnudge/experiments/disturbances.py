"""Frictions and masses other than they were thought to be, one quantity at a time, and draws verified again there."""

from dataclasses import replace

import numpy as np

from dexnudge.mechanics.fast_balance import force_margins
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts
from dexnudge.verification.criteria import SUCCESS_MARGIN
from dexnudge.verification.verdicts import Verdicts

VERIFIED_AT = (
    ("friction_environment", 0.5),
    ("friction_environment", 1.5),
    ("friction_hand", 0.75),
    ("friction_hand", 1.25),
    ("mass", 0.5),
    ("mass", 2.0),
)
"""Quantities of the scene and factors at which draws are verified again."""
EXECUTED_AT = tuple(
    (name, factor) for name in ("friction_hand", "friction_environment", "mass") for factor in (0.5, 1.5)
)
"""The same in physics, while approach and forces are planned without the factor."""
AS_DRAWN = "as drawn"  # the setting for which draws were made, ranked and planned
BALANCE_REASONS = ("", "force_margin")
"""Reasons of draws that have passed all that friction and mass do not change; "" is a verified one."""


def setting_name(quantity: str, factor: float) -> str:
    """Return what records and reports call a setting, such as "mass x 2"."""
    return f"{quantity} x {factor:g}"


def disturbed_scene(scene: Scene, quantity: str, factor: float) -> Scene:
    """Return the scene with one quantity multiplied."""
    return replace(scene, **{quantity: factor * getattr(scene, quantity)})


def verify_disturbed(scene: Scene, verdicts: Verdicts) -> dict[str, list[bool]]:
    """Return whether each draw succeeds at each setting of `VERIFIED_AT`, in the order of the verdicts.

    Equal to verifying in `disturbed_scene`: penetration, limits, contacts and supports do not depend on what changes, so
    only the force balance is solved again.
    """
    places = [place for place, reason in enumerate(verdicts.reasons) if reason in BALANCE_REASONS]
    contacts, supports = [verdicts.contacts[place] for place in places], support_contacts(scene)
    found: dict[str, list[bool]] = {}
    for quantity, factor in VERIFIED_AT:
        margins = force_margins(contacts, supports, sliding_task(disturbed_scene(scene, quantity, factor)))
        success = np.zeros(len(verdicts.success), dtype=bool)
        success[places] = (margins.factor[:, 0] >= SUCCESS_MARGIN) & margins.balanced[:, 0]
        found[setting_name(quantity, factor)] = success.tolist()
    return found
