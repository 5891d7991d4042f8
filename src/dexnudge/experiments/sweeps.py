"""The same draws judged again where friction or mass is other than it was thought to be; nothing is drawn anew."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dexnudge.mechanics.contacts import HandContacts, support_contacts
from dexnudge.mechanics.fast_balance import force_margins
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import SUCCESS_MARGIN
from dexnudge.verification.verdicts import Verdicts

SWEEPS: dict[str, tuple[float, ...]] = {
    "friction_environment": (0.5, 1.5),
    "friction_hand": (0.75, 1.25),
    "mass": (0.5, 2.0),
}
"""Quantity of the scene -> factors on it, one quantity at a time."""
FORCE = "force_margin"
"""The verdicts' last reason: a draw with it, and a verified one, has passed all that friction and mass do not change."""


def setting_name(quantity: str, factor: float) -> str:
    """How a setting is called in rows and reports, such as "mass x 2"."""
    return f"{quantity} x {factor:g}"


def changed_scene(scene: Scene, quantity: str, factor: float) -> Scene:
    """The scene with one quantity multiplied."""
    return replace(scene, **{quantity: factor * getattr(scene, quantity)})


def sweep_success(scene: Scene, verdicts: Verdicts, contacts: Mapping[int, HandContacts]) -> dict[str, list[bool]]:
    """Whether each draw succeeds, by setting, in the order of the verdicts.

    Equal to judging in `changed_scene`: penetration, limits, contacts and supports do not depend on what is swept, so
    only the force balance is solved again.

    Args:
        scene: as it was judged.
        verdicts: of all draws there.
        contacts: of each draw whose reason is "" or `FORCE`, by its place.
    """
    places, supports = sorted(contacts), support_contacts(scene)
    swept: dict[str, list[bool]] = {}
    for quantity, factors in SWEEPS.items():
        for factor in factors:
            task = sliding_task(changed_scene(scene, quantity, factor))
            margins = force_margins([contacts[place] for place in places], supports, task)
            success = np.zeros(len(verdicts.success), dtype=bool)
            success[places] = (margins.factor[:, 0] >= SUCCESS_MARGIN) & margins.balanced[:, 0]
            swept[setting_name(quantity, factor)] = success.tolist()
    return swept
