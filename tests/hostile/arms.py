"""Hostile descriptions of arms, and the YAML beside them."""

from __future__ import annotations

import random
from typing import Any

from hostile.case import Draw, Hostile
from hostile.hands import WORDS, chain, damaged_lines, joint, link
from hostile.mutations import damaged_xml

ARM_YAML = "flange: l4\nhome: [0.1, 0.2, 0.3, 0.4]\nlimits: {velocity: 2, acceleration: [1, 2, 3, 4], jerk: 100}\n"


def arm_urdf() -> str:
    """Return an arm of four joints."""
    links = [link(f"l{number}", "0.06 0.06 0.3", "0 0 0.15") for number in range(5)]
    joints = [joint(f"j{number}", f"l{number - 1}", f"l{number}", "0 0 0.3") for number in (1, 2, 3, 4)]
    return f'<robot name="arm">{"".join(links)}{"".join(joints)}</robot>'


def arm_case(name: str, text: str | bytes, expected: Any = "either", says: str = "", yaml: bytes = b"") -> Hostile:
    """Return the case of `dexnudge arm` with a URDF."""
    data = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    files = {"arm.urdf": data, "arm.yaml": yaml or ARM_YAML.encode()}
    return Hostile("arm", name, files, ("arm", "arm.urdf"), expected, says)


def _arm(rng: random.Random) -> Hostile:
    if rng.random() < 0.5:
        what, data = damaged_lines(ARM_YAML, rng)
        return arm_case(f"its YAML: {what}", arm_urdf(), yaml=data or b"\n")
    return arm_case(*damaged_xml(arm_urdf().encode(), rng, WORDS))


ARMS = {
    "valid": (arm_urdf(), "accepted", b""),
    "a velocity of 0": (arm_urdf(), "refused", b"limits: {velocity: 0}\n"),
    "a velocity of -1": (arm_urdf(), "refused", b"limits: {velocity: -1}\n"),
    "a jerk of NaN": (arm_urdf(), "refused", b"limits: {jerk: .nan}\n"),
    "a jerk of infinity": (arm_urdf(), "refused", b"limits: {jerk: .inf}\n"),
    "a jerk of 400 digits": (arm_urdf(), "refused", b"limits: {jerk: " + b"9" * 400 + b"}\n"),
    "a home outside the limits": (arm_urdf(), "refused", b"home: [9, 9, 9]\n"),
    "a home of text": (arm_urdf(), "refused", b"home: rest\n"),
    "a flange that is none": (arm_urdf(), "refused", b"flange: nothing\n"),
    "a flange of control characters": (arm_urdf(), "refused", b'flange: "\\e[31m"\n'),
    "a key twice": (arm_urdf(), "refused", b"flange: l3\nflange: l2\n"),
    "5,000 joints": (arm_urdf().replace("</robot>", chain(5000).replace("atip", "l4") + "</robot>"), "refused", b""),
    "a cycle": (arm_urdf().replace("</robot>", joint("back", "l4", "l0", "0 0 0") + "</robot>"), "refused", b""),
    "limits in degrees": (arm_urdf().replace('upper="1.3"', 'upper="180"'), "refused", b""),
}
HANDMADE = [arm_case(name, text, expected, yaml=yaml) for name, (text, expected, yaml) in ARMS.items()]
DRAWS: dict[str, Draw] = {"arm": _arm}
