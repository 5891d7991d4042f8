"""Any arm from a URDF or MJCF, and a YAML beside it that states what these do not."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.arms.arm import Arm, JointLimits
from dexnudge.arms.config import LIMITS, ArmConfig, per_joint, read_arm_config
from dexnudge.arms.flange import ALONG, cut_at, find_flange, from_base, last_axis, outward_frame
from dexnudge.arms.inverse_kinematics import InverseKinematics
from dexnudge.errors import ArmError, HandError
from dexnudge.hands.config import GEOMETRIES, yaml_beside
from dexnudge.hands.joint_ranges import Farthest, with_ranges
from dexnudge.hands.link_meshes import package_file
from dexnudge.hands.registry import read_robot_tree
from dexnudge.hands.tree import Tree, TreeJoint, check_sizes

OTHER_YAML = "arm.yaml"  # beside the description, where there is no `<stem>.yaml`
ENDLESS = 2 * np.pi  # [rad] either way: joints without limits turn on, but cables do not
OF_AN_ARM = Farthest(turn=4 * np.pi, slide=20.0)  # wrists turn once and a half about; rails are as long as a hall
FASTEST = {False: 35.0, True: 20.0}  # [rad/s] and, of slides, [m/s]: what is more is in degrees or millimetres
ROUNDED = 1e-6  # [rad or m] by which a home may lie beyond printed limits


def arm_from_description(
    path: Path, config: ArmConfig | None = None, *, packages: Mapping[str, Path | str] | None = None
) -> Arm:
    """Return the arm that a URDF or MJCF file describes, at the world's origin.

    Args:
        path: the description; everything below its flange and what else hangs there is cut off.
        config: what it does not state; None: the YAML beside it, `<stem>.yaml` or `arm.yaml`, or nothing.
        packages: folders of the ROS packages that it names.

    Raises:
        ArmError: anything that cannot be used as given, with the place and the remedy.
    """
    beside = yaml_beside(path, OTHER_YAML) if config is None else None
    where = str(beside or path)
    config = config or (ArmConfig() if beside is None else read_arm_config(beside))
    try:
        tree = from_base(_tree(path, config, packages), config)
        flange = config.flange or find_flange(tree, str(path))
        tree = _with_hulls(cut_at(tree, flange, str(path)), path, config, packages)
        check_sizes(tree, OF_AN_ARM.slide)
        tree = with_ranges(_with_limits(tree, config, where), OF_AN_ARM)
    except HandError as error:
        raise ArmError(str(error)) from error
    notes = list(tree.notes)
    if config.flange is None:
        notes.append(f"the flange is '{flange}'; 'flange' in the arm's YAML names another")
    if abs(float(last_axis(tree, flange)[2])) < ALONG:
        notes.append(
            f"the z-axis of '{flange}' does not lie along the last joint's: unless told otherwise, hands are mounted along "
            "the axis that does; is another link the flange?"
        )
    names = tuple(joint.name for joint in tree.chain_to(flange) if not joint.fixed and joint.mimic is None)
    limits = _limits(tree, names, config, where, path)
    arm = Arm(config.name or tree.name, tree, names, limits, limits.lower, flange, notes=tuple(notes), source=path)
    home, note = _home(arm, config, where)
    return replace(arm, home=home, notes=(*notes, *([note] if note else [])))


def arm_from_package(package: str, end: str, config: ArmConfig) -> Arm:
    """Return the arm of a description in an installed package, the file whose path ends in `end`.

    Raises:
        ArmError: the package is not installed, or the description cannot be used.
    """
    try:
        path = package_file(package, end, what=f"arm '{config.name}'", install="pip install 'dexnudge[arms]'")
    except HandError as error:
        raise ArmError(str(error)) from error
    return arm_from_description(path, config)


def _tree(path: Path, config: ArmConfig, packages: Mapping[str, Path | str] | None) -> Tree:
    """Return the description's tree with the geometry that is asked for, or that it has."""
    wanted = (config.geometry,) if config.geometry else GEOMETRIES
    for geometry in wanted:
        tree = read_robot_tree(path, geometry, packages=packages, link=config.flange)
        if any(len(mesh.faces) for mesh in tree.links.values()):
            note = f"{geometry} geometry is judged: the description has no other"
            return replace(tree, notes=(*tree.notes, note)) if geometry != wanted[0] else tree
    raise ArmError(f"{path}: expected {' or '.join(wanted)} geometry, found none; add meshes or shapes to the links")


def _with_hulls(tree: Tree, path: Path, config: ArmConfig, packages: Mapping[str, Path | str] | None) -> Tree:
    """Return the tree with hulls of what is only shown for links that could not collide, as the bases of many models."""
    solid = {joint.child for joint in tree.joints if not joint.fixed} | {next(iter(tree.links))}
    bare = [link for link in tree.links if link in solid and not len(tree.links[link].faces)]
    if not bare or config.geometry is not None:
        return tree
    try:
        shown = read_robot_tree(path, GEOMETRIES[1], packages=packages, link=config.flange, only=bare).links
    except HandError:  # what is only to be looked at may be missing, or of a kind that is not read
        return tree
    hulls = {link: shown[link].convex_hull for link in bare if link in shown and len(shown[link].faces)}
    note = f"no collision geometry: the hull of the visual one stands for it: {', '.join(hulls)}"
    return replace(tree, links={**tree.links, **hulls}, notes=(*tree.notes, note)) if hulls else tree


def _with_limits(tree: Tree, config: ArmConfig, where: str) -> Tree:
    """Return the tree with the position limits of the YAML in place of its own, and some for those that have none."""
    stated = {key: config.limits[key] for key in ("lower", "upper") if key in config.limits}
    names = [joint.name for joint in tree.joints if not joint.fixed and joint.mimic is None]
    ends = {key: dict(zip(names, per_joint(value, names, key, where), strict=True)) for key, value in stated.items()}
    joints = []
    for joint in tree.joints:
        mine = {key: float(values.get(joint.name, np.nan)) for key, values in ends.items()}
        limits = {key: value for key, value in mine.items() if not np.isnan(value)}
        endless = joint.endless and len(limits) < 2
        limits = {"lower": -ENDLESS, "upper": ENDLESS} if endless else limits
        lower, upper = limits.get("lower", joint.lower), limits.get("upper", joint.upper)
        joints.append(replace(joint, lower=lower, upper=upper, endless=endless))
    return replace(tree, joints=tuple(joints))


def _limits(tree: Tree, names: tuple[str, ...], config: ArmConfig, where: str, path: Path) -> JointLimits:
    joints = [joint for name in names for joint in tree.joints if joint.name == name]
    empty = [joint for joint in joints if not joint.lower < joint.upper]
    if empty:
        raise ArmError(
            f"{where}: joint '{empty[0].name}': expected a lower limit below the upper one, got {empty[0].lower:g} and "
            f"{empty[0].upper:g}; mend them, or fix the joint"
        )
    found = {"lower": np.array([joint.lower for joint in joints]), "upper": np.array([joint.upper for joint in joints])}
    for key in LIMITS:
        if key not in found:
            own = [getattr(joint, key, None) for joint in joints]
            found[key] = np.array([np.nan if value in (None, 0.0, np.inf) else value for value in own])
            if key in config.limits:
                stated = per_joint(config.limits[key], names, key, where)
                found[key] = np.where(np.isnan(stated), found[key], stated)
                own = [None if np.isfinite(value) else each for value, each in zip(stated, own, strict=True)]
            _refuse_nonsense(found[key], own, joints, key, where)
    missing = {key: [name for name, value in zip(names, found[key], strict=True) if np.isnan(value)] for key in LIMITS}
    if any(missing.values()):
        raise _missing(missing, names, path)
    return JointLimits(**found)


def _refuse_nonsense(
    values: Float[np.ndarray, " n"], own: list[Any], joints: list[TreeJoint], key: str, where: str
) -> None:
    """Refuse limits of no size, and speeds in another unit."""
    for joint, value, stated in zip(joints, values, own, strict=True):
        unit = LIMITS[key][joint.slides]
        if value <= 0.0 or (stated is not None and np.isnan(stated)):
            raise ArmError(
                f"{where}: joint '{joint.name}': expected a limit of {key} above 0 {unit}, got "
                f"{stated if stated is not None else value}; mend it"
            )
        if key == "velocity" and value > FASTEST[joint.slides]:
            degrees = f"in degrees? write {np.radians(value):.4g}"
            smaller = f"in millimetres? write {value / 1e3:g}" if joint.slides else degrees
            raise ArmError(
                f"{where}: joint '{joint.name}': expected a limit of velocity in {unit}, at most "
                f"{FASTEST[joint.slides]:g}, got {value:g}; {smaller}"
            )


def _missing(missing: dict[str, list[str]], names: tuple[str, ...], path: Path) -> ArmError:
    """Return the error that says which limits are missing of which joints, and what to write."""
    lines, said = [], []
    for key, joints in missing.items():
        if joints:
            of = "all joints" if len(joints) == len(names) else ", ".join(joints)
            said.append(f"{key} of {of}")
            value = "?" if len(joints) == len(names) else "{" + ", ".join(f"{name}: ?" for name in joints) + "}"
            lines.append(f"  {key}: {value}  # [{LIMITS[key][0]}], a number for all joints, or {{joint: number}}")
    own = path.with_suffix(".yaml")
    beside = yaml_beside(path, OTHER_YAML) or (path.with_name(OTHER_YAML) if own.is_file() else own)
    return ArmError(
        f"{path}: limits missing: {'; '.join(said)}: expected them in the description or in the YAML beside it; write the "
        f"numbers of its maker in place of ? into {beside}:\nlimits:\n" + "\n".join(lines)
    )


def _home(arm: Arm, config: ArmConfig, where: str) -> tuple[Float[np.ndarray, " n"], str]:
    """Return the home, and what was assumed of it."""
    low, high = arm.limits.lower, arm.limits.upper
    if config.home is not None:
        home = per_joint(config.home, arm.joint_names, "home", where)
        missing = [name for name, value in zip(arm.joint_names, home, strict=True) if np.isnan(value)]
        if missing:
            raise ArmError(
                f"{where}: key 'home': expected an angle of every joint, missing {', '.join(missing)}; add them"
            )
        for name, value, lower, upper in zip(arm.joint_names, home, low, high, strict=True):
            if not lower - ROUNDED <= value <= upper + ROUNDED:
                raise ArmError(
                    f"{where}: key 'home': expected joint '{name}' within its limits, {lower:g} to {upper:g}, got "
                    f"{value:g}; mend the home or the limits"
                )
        return np.clip(home, low, high), ""
    if set(arm.joint_names) <= set(arm.tree.home):
        home = np.array([arm.tree.home[name] for name in arm.joint_names])
        if (home >= low - ROUNDED).all() and (home <= high + ROUNDED).all():
            return np.clip(home, low, high), "the home is the description's own; 'home' in the arm's YAML names another"
    chosen = "the flange half the reach ahead, what it carries facing down, or else the middle of the limits"
    return home_in_front(arm), f"the home was chosen: {chosen}; 'home' in the arm's YAML names another"


AHEAD, UP = 0.45, 0.35  # of the reach: where the flange is, seen from the base
STARTS = 12


def home_in_front(arm: Arm) -> Float[np.ndarray, " n"]:
    """Return joint angles at which what is mounted faces down in front of the base, the joints as high as they may be.

    The middle of the limits, with joints at zero where that is within them, if no such angles are found.
    """
    limits = arm.limits
    straight = np.clip(0.0, limits.lower, limits.upper)
    target = np.diag([1.0, -1.0, -1.0, 1.0])
    target[:3, 3] = [AHEAD * arm.reach, 0.0, UP * arm.reach]
    target = target @ np.linalg.inv(outward_frame(arm))
    solver, generator = InverseKinematics(arm), np.random.default_rng(0)
    starts = [straight, *generator.uniform(limits.lower, limits.upper, (STARTS, arm.num_joints))]
    found = [home for start in starts if (home := solver.solve(arm.T_world_base @ target, start)) is not None]
    turned = [_near_zero(home, arm) for home in found]
    return max(turned, key=lambda home: _worth(home, arm)) if turned else straight


def _near_zero(position: Float[np.ndarray, " n"], arm: Arm) -> Float[np.ndarray, " n"]:
    """Return the same pose with joints that turn farther than half a turn turned back, where their limits allow it."""
    turns = np.array([not joint.slides for joint in arm.chain if joint.name in arm.joint_names])
    nearer = np.where(turns, (position + np.pi) % (2 * np.pi) - np.pi, position)
    allowed = (nearer >= arm.limits.lower) & (nearer <= arm.limits.upper)
    return np.where(allowed, nearer, position)


def _worth(position: Float[np.ndarray, " n"], arm: Arm) -> float:
    """Return how high the joints stand, in reaches, less a tenth of how far they turn [rad]."""
    poses = arm.link_poses(position)
    heights = [poses[joint.child][2, 3] for joint in arm.chain]
    return float(np.mean(heights) / arm.reach - 0.1 * np.abs(position).mean())
