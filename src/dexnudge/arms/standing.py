"""Where an arm stands in a scene: a sensible place, what is wrong with a given one, and a floor below it."""

from dataclasses import replace
from numbers import Real
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.arms.arm import Arm
from dexnudge.arms.robot import Robot
from dexnudge.errors import ArmError, InputError, check_kind, quote
from dexnudge.geometry.overlap import deepest_overlap
from dexnudge.scenes.placement import surroundings_distance
from dexnudge.scenes.scene import Scene

DISTANCE = 0.7  # [m] from the object: from there, the named arms get into a shelf and out of it again
STEP, MOST_STEPS = 0.02, 30  # [m] by which the base moves outward while it touches the surroundings
STAND = (0.1, 0.1, 0.05)  # [m] what an arm without geometry at its base stands on
DEEPEST = 0.001  # [m] by which it may stand in them: meshes that touch, after rounding


def default_base(arm: Arm, scene: Scene, *, distance: float = DISTANCE) -> Float[np.ndarray, "4 4"]:
    """Return T_world_base of an arm that looks at the object from where it goes, at the height of its underside.

    `distance` [m] away, or as much farther as the base needs to be clear of the surroundings; z up, x towards the object.

    Raises:
        ArmError: the surroundings leave no place within 0.6 m more.
    """
    check_kind("arm", arm, Arm, 'load_arm("panda")')
    check_kind("scene", scene, Scene, 'build_scene("table", "phone", seed=0)')
    bounds = scene.object_in_world().bounds
    way = np.array([*scene.motion[:2], 0.0])
    way = way / np.linalg.norm(way) if np.linalg.norm(way) > 1e-3 else np.array([1.0, 0.0, 0.0])
    T_world_base = np.eye(4)
    T_world_base[:3, :3] = np.stack([-way, np.cross([0.0, 0.0, 1.0], -way), [0.0, 0.0, 1.0]], axis=1)
    for step in range(MOST_STEPS + 1):
        T_world_base[:3, 3] = bounds.mean(axis=0) + (distance + step * STEP) * way
        T_world_base[2, 3] = bounds[0, 2]
        depth, where = standing_depth(arm.standing_at(T_world_base), scene)
        if depth <= DEEPEST:
            return T_world_base
    raise ArmError(
        f"'{arm.name}' finds no place: expected room for its base {distance:g} to {distance + MOST_STEPS * STEP:g} m from "
        f"the object along its motion, but the surroundings are {1e3 * depth:.0f} mm deep in it at {_point(where)}; "
        "give `arm_base`"
    )


def check_base(robot: Robot, scene: Scene) -> None:
    """Refuse a place that is taken by the surroundings or the object, or from which the object is out of reach; ArmError."""
    depth, where = standing_depth(robot.arm, scene)
    if depth > DEEPEST:
        raise ArmError(
            f"the base of '{robot.arm.name}' stands in what is around it: {1e3 * depth:.0f} mm deep at {_point(where)}; "
            f"expected at most {1e3 * DEEPEST:g} mm; move `arm_base`"
        )
    place, reach = robot.arm.T_world_base[:3, 3], robot.arm.reach + _length(robot)
    low, high = scene.object_in_world().bounds
    away = float(np.linalg.norm(np.clip(place, low, high) - place))
    if away > reach:
        raise ArmError(
            f"the object is out of reach: {away:.2f} m from the base of '{robot.arm.name}', expected at most {reach:.2f} m, "
            f"{robot.arm.reach:.2f} m to the flange and {_length(robot):.2f} m of the hand; move `arm_base` nearer"
        )


def standing_depth(arm: Arm, scene: Scene) -> tuple[float, Float[np.ndarray, " 3"]]:
    """Return how deep the links that never move stand in surroundings or object [m], and where."""
    base = standing_mesh(arm)
    found = []
    for body in (surroundings_distance(scene.environment_mesh), scene.object_in_world()):
        bounds = (body if isinstance(body, trimesh.Trimesh) else body.mesh).bounds
        if (base.bounds[0] < bounds[1]).all() and (bounds[0] < base.bounds[1]).all():
            found.append(deepest_overlap(base, body)[:2])
    return max(found, key=lambda pair: pair[0], default=(0.0, np.zeros(3)))


def standing_mesh(arm: Arm) -> trimesh.Trimesh:
    """Return the links that never move as one mesh where the arm stands [m]; a small box for an arm without any."""
    still, poses = arm.rigid_with(arm.base), arm.link_poses(arm.home)
    meshes = [(link, mesh) for link, mesh in arm.tree.links.items() if link in still and len(mesh.faces)]
    placed = [mesh.copy().apply_transform(poses[link]) for link, mesh in meshes]
    if placed:
        return trimesh.util.concatenate(placed)
    above = trimesh.transformations.translation_matrix([0.0, 0.0, STAND[2] / 2])
    return trimesh.creation.box(STAND, transform=arm.T_world_base @ above)


def _length(robot: Robot) -> float:
    """Return the greatest distance of the open hand's geometry from the flange [m]."""
    body, links = robot.body, len(robot.arm.tree.links)
    poses, flange = robot.at_home(), robot.arm.flange_poses(robot.arm.home[None])[0, :3, 3]
    distances = [
        np.linalg.norm(trimesh.transform_points(mesh.vertices, pose) - flange, axis=1).max(initial=0.0)
        for mesh, pose in zip(body.link_meshes[links:], poses[links:], strict=True)
    ]
    return float(max(distances))


def _point(where: Float[np.ndarray, " 3"]) -> str:
    return f"({', '.join(f'{value:.2f}' for value in where)})"


def _is_height(value: object) -> bool:
    return isinstance(value, Real) and abs(float(value)) <= FARTHEST_FLOOR


FARTHEST_FLOOR = 1000.0  # [m] from the origin
SIDE, THICKNESS = 3.0, 0.02  # [m] of the slab: beyond any reach to all sides
ASSUMED = 1  # what `metadata["origin"]` of measured surroundings says of a face that no camera saw


def with_floor(scene: Scene, arm: Arm, floor: float) -> Scene:
    """Return the scene with a slab of 3 x 3 m below the arm's base, its top at `floor` [m, world z].

    The base may stand on it, and the object lie on it.

    Raises:
        InputError: `floor` is no number, or farther away than any.
        ArmError: the base or the object would stand in it by more than 1 mm.
    """
    if not _is_height(floor):
        raise InputError(
            f"`floor` is {quote(floor)}; expected the height of its top [m, world z], at most {FARTHEST_FLOOR:g} either way"
        )
    lowest = {"the object": scene.way_bounds()[0, 2], f"the base of '{arm.name}'": standing_mesh(arm).bounds[0, 2]}
    for what, height in lowest.items():
        if height < floor - DEEPEST:
            raise ArmError(
                f"`floor` is {floor:g} m, {1e3 * (floor - height):.0f} mm above the underside of {what}; expected at most "
                f"{height:.3f} m"
            )
    x, y = arm.T_world_base[:2, 3]
    centre = trimesh.transformations.translation_matrix((x, y, floor - THICKNESS / 2))
    slab = trimesh.creation.box((SIDE, SIDE, THICKNESS), transform=centre)
    around = scene.environment_mesh
    joined = trimesh.util.concatenate([around, slab])
    metadata: dict[str, Any] = dict(around.metadata)
    if "origin" in metadata:
        metadata["origin"] = np.append(metadata["origin"], np.full(len(slab.faces), ASSUMED, metadata["origin"].dtype))
    joined.metadata = metadata
    return replace(scene, environment_mesh=joined)
