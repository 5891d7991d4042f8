"""Frictions and masses other than they were thought to be, one quantity at a time, and draws verified again there."""

from collections.abc import Mapping
from typing import TypeVar

from dexnudge.results.worlds import balanced_in
from dexnudge.scenes.scene import Scene
from dexnudge.verification.verdicts import Verdicts

Rate = TypeVar("Rate")
VERIFIED_AT = (
    ("friction_environment", 0.5),
    ("friction_environment", 1.5),
    ("friction_hand", 0.75),
    ("friction_hand", 1.25),
    ("mass", 0.5),
    ("mass", 2.0),
)
"""Quantities of the scene and factors at which draws are verified again."""
EXECUTED_AT = (
    ("friction_hand", 0.5),
    ("friction_hand", 0.75),
    ("friction_environment", 1.5),
    ("mass", 0.5),
    ("mass", 2.0),
)
"""The same in physics, while approach and forces are planned without the factor."""
AS_DRAWN = "as drawn"  # the setting for which draws were made, ranked and planned


def setting_name(quantity: str, factor: float) -> str:
    """Return what records and reports call a setting, such as "mass x 2"."""
    return f"{quantity} x {factor:g}"


def curves_of(rates: Mapping[str, Rate]) -> dict[str, dict[str, dict[float, Rate]]]:
    """Return rates by the name of their setting as quantity -> way to act -> factor -> rate, as far as there are such.

    A setting of another way to act than the planned one has that way's name behind it, such as "mass x 2, open loop".
    """
    found: dict[str, dict[str, dict[float, Rate]]] = {}
    for quantity in dict.fromkeys(quantity for quantity, _ in EXECUTED_AT):
        factors = {AS_DRAWN: 1.0} | {
            setting_name(quantity, factor): factor for each, factor in EXECUTED_AT if each == quantity
        }
        for name, rate in rates.items():
            setting, _, way = name.partition(", ")
            if setting in factors:
                found.setdefault(quantity, {}).setdefault(way or "as executed", {})[factors[setting]] = rate
    return found


def verify_disturbed(scene: Scene, verdicts: Verdicts) -> dict[str, list[bool]]:
    """Return whether each draw succeeds at each setting of `VERIFIED_AT`, in the order of the verdicts.

    Equal to verifying in a scene with that setting.
    """
    worlds = [{quantity: factor * getattr(scene, quantity)} for quantity, factor in VERIFIED_AT]
    found = balanced_in(scene, verdicts, worlds)
    return {setting_name(*setting): success.tolist() for setting, success in zip(VERIFIED_AT, found, strict=True)}
