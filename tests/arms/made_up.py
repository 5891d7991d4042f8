"""Arms that the tests make up: six joints that turn, on a rail or not, as URDF and as MJCF."""

from collections.abc import Callable

import numpy as np

ORIGINS = (  # xyz and rpy of each joint, in the frame of the link before it; nothing is aligned with anything
    ("0.01 -0.02 0.15", "0.1 0 0.3"),
    ("0.05 0.02 0.1", "-1.5 0.1 0"),
    ("0.3 0.01 0", "0 0.05 -0.1"),
    ("0.25 0 0.03", "0.02 0 1.5"),
    ("0 0.05 0.1", "1.6 0 0"),
    ("0 -0.1 0.02", "-1.4 0.2 0"),
)
AXES = ("0 0 1", "0.1 0 1", "0 0.2 1", "0 0 -1", "0 0 1", "0 0 1")
LIMITS = {"acceleration": 6, "jerk": "1e2"}  # 1e2 is text in YAML
SLIDE = '<axis xyz="0 1 0"/><limit lower="-1" upper="1.5" velocity="0.8" effort="500"/>'
FLANGE_AXIS = ("0.01 0 0.06", "0 0 0.7")


def joint(name: str, parent: str, child: str, origin: tuple[str, str], inside: str, kind: str = "revolute") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin[0]}" rpy="{origin[1]}"/>{inside}</joint>'
    )


def limit(lower: float = -2.5, upper: float = 2.8, velocity: float = 3.0, effort: float = 40.0) -> str:
    return f'<limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="{effort}"/>'


def link(name: str, box: str = "0.06 0.05 0.12") -> str:
    return f'<link name="{name}"><collision><geometry><box size="{box}"/></geometry></collision></link>'


def six_axis_urdf(
    *, rail: bool = False, end: str = "tool0", extra: str = "", change: Callable[[str], str] = str
) -> str:
    """Return the URDF of an arm; `change` may rewrite it."""
    parts = [link("l0")]
    first = "l0"
    if rail:
        parts += [
            link("carriage"),
            joint("rail", "l0", "carriage", ("0 0 0.1", "0 0 0.2"), "<axis xyz='0 1 0'/>", "prismatic"),
        ]
        parts[-1] = parts[-1].replace("</joint>", '<limit lower="-1" upper="1.5" velocity="0.8" effort="500"/></joint>')
        first = "carriage"
    for number, (origin, axis) in enumerate(zip(ORIGINS, AXES, strict=True), 1):
        parent = first if number == 1 else f"l{number - 1}"
        parts += [
            link(f"l{number}"),
            joint(f"j{number}", parent, f"l{number}", origin, f'<axis xyz="{axis}"/>{limit()}'),
        ]
    parts += [f'<link name="{end}"/>', joint("mount", "l6", end, FLANGE_AXIS, "", "fixed"), extra]
    return change(f'<robot name="six">{"".join(parts)}</robot>')


def six_axis_mjcf(*, rail: bool = False) -> str:
    """Return the MJCF of an arm whose first joint, or rail, is the topmost body's; a site is its flange."""
    bodies, ends = [], []
    if rail:
        bodies.append(
            '<body name="carriage" pos="0 0.1 0.2" euler="0 0 0.2">'
            '<joint name="rail" type="slide" axis="0 1 0" range="-1 1.5"/><geom size="0.05"/>'
        )
        ends.append("</body>")
    for number, ((xyz, rpy), axis) in enumerate(zip(ORIGINS, AXES, strict=True), 1):
        bodies.append(
            f'<body name="l{number}" pos="{xyz}" euler="{rpy}"><joint name="j{number}" axis="{axis}" range="-2.5 2.8" '
            f'pos="0 {0.01 * number} 0" ref="{0.1 * number}"/><geom type="capsule" size="0.03 0.05"/>'
        )
        ends.append("</body>")
    motors = "".join(f'<motor joint="j{number}" forcerange="-30 20" gear="2"/>' for number in range(1, 7))
    motors += '<motor joint="rail" forcerange="-400 400"/>' if rail else ""
    site = '<site name="attachment_site" pos="0.01 0 0.06" euler="0 0 0.7"/>'
    return (
        f'<mujoco model="six"><compiler angle="radian" eulerseq="XYZ"/><worldbody>{"".join(bodies)}{site}{"".join(ends)}'
        f"</worldbody><actuator>{motors}</actuator></mujoco>"
    )


def inside(arm, count: int = 8) -> np.ndarray:
    """Return joint angles within the limits."""
    return np.random.default_rng(1).uniform(arm.limits.lower, arm.limits.upper, (count, arm.num_joints))
