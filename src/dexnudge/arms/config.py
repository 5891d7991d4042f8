"""What a URDF or MJCF does not say about an arm: its flange, its home, and how fast its joints may go."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import ArmError, did_you_mean, quote
from dexnudge.hands.config import Geometry, read_yaml
from dexnudge.jobs.json_files import Must, Name, from_fields

Values = Any  # one number for all joints, a list of one each, or a mapping of joint to number
LIMITS = {  # unit, and that of joints that slide
    "lower": ("rad", "m"),
    "upper": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "acceleration": ("rad/s^2", "m/s^2"),
    "jerk": ("rad/s^3", "m/s^3"),
    "effort": ("N m", "N"),
}
STATED = Must(f"lines such as 'jerk: 100', of {', '.join(LIMITS)}", lambda limits: limits.keys() <= LIMITS.keys())


@dataclass(frozen=True)
class ArmConfig:
    """Facts that stand beside a robot description.

    Attributes:
        flange: link, or site of an MJCF, that a hand is mounted on; its z-axis points out of the arm.
        base: link that stands where the arm is put, where that is not the description's first.
        home: joint angles [rad], [m] of joints that slide: a list, or by joint.
        limits: lower, upper, velocity, acceleration, jerk, effort: a number, a list, or by joint.
        geometry: which of the description's geometry is judged, "collision" or "visual"; None: collision unless it has none.
        name: the arm's name; None: the description's own.
    """

    flange: Name | None = None
    base: Name | None = None
    home: Values = None
    limits: Annotated[dict[str, Values], STATED] = field(default_factory=dict)
    geometry: Geometry | None = None
    name: Name | None = None


def read_arm_config(path: Path) -> ArmConfig:
    """Return the configuration in a YAML file.

    Raises:
        ArmError: missing file, not YAML, an unknown key, or a value of another kind.
    """
    raw = read_yaml(path, [each.name for each in fields(ArmConfig)], robot="arm", error=ArmError)
    given = {key: value for key, value in raw.items() if value is not None}
    config = from_fields(given, ArmConfig, str(path), error=ArmError, again="mend it")
    return replace(config, limits={key: value for key, value in config.limits.items() if value is not None})


def per_joint(values: Values, joints: Sequence[str], key: str, where: str) -> Float[np.ndarray, " n"]:
    """Return one number for each joint, NaN where a mapping names no value.

    Raises:
        ArmError: anything but finite numbers, another count than that of the joints, or a joint that the arm does not have.
    """

    def wrong(expected: str, got: Any) -> ArmError:
        return ArmError(f"{where}: key '{key}': expected {expected}, got {quote(got)}; mend it")

    if isinstance(values, dict):
        unknown = [name for name in values if name not in joints]
        if unknown:
            meant = did_you_mean(unknown[0], joints)
            raise wrong(f"joints of the arm, {', '.join(joints)}", unknown[0] + meant if meant else unknown[0])
        values = [values.get(name) for name in joints]
    elif not isinstance(values, list):
        values = [values] * len(joints)
    if len(values) != len(joints):
        raise wrong(f"{len(joints)} numbers, of {', '.join(joints)}", values)
    found = np.array([np.nan if value is None else _number(value) for value in values])
    for joint, value, number in zip(joints, values, found, strict=True):
        if value is not None and not np.isfinite(number):
            raise wrong(f"a finite number for '{joint}'", value)
    return found


def _number(value: Any) -> float:
    """Return a number of a YAML, where 1e4 is text; NaN for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return np.nan
    try:
        return float(value)
    except (ValueError, OverflowError):
        return np.nan
