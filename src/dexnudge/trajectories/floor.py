"""What an arm stands on: a slab that joins a scene's surroundings, and how far a plan comes below the arm's base."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
import trimesh

from dexnudge.arms.arm import Arm
from dexnudge.arms.standing import DEEPEST, standing_mesh
from dexnudge.errors import ArmError, InputError, quote
from dexnudge.scenes.scene import Scene
from dexnudge.trajectories.plan import Plan

SIDE, THICKNESS = 3.0, 0.02  # [m] of the slab: beyond any reach to all sides
ASSUMED = 1  # what `metadata["origin"]` of measured surroundings says of a face that no camera saw
UPRIGHT = 0.99  # cosine between a base's z-axis and the world's, from which on it stands on something


def with_floor(scene: Scene, arm: Arm, floor: float) -> Scene:
    """Return the scene with a slab of 3 x 3 m below the arm's base, its top at `floor` [m, world z].

    The base may stand on it, and the object lie on it.

    Raises:
        InputError: `floor` is no finite number.
        ArmError: the base or the object would stand in it by more than 1 mm.
    """
    if not np.isfinite(floor):
        raise InputError(f"`floor` is {quote(floor)}; expected the height of its top [m, world z]")
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


def below_base(plan: Plan) -> float:
    """Return how far arm and hand come below the plane that the base stands on [m]; 0 for one that does not stand upright.

    Of the samples' positions, by the hulls of all links that move.
    """
    robot, body = plan.robot, plan.robot.body
    if robot.arm.T_world_base[2, 2] < UPRIGHT:
        return 0.0
    poses = body.forward_kinematics(torch.as_tensor(robot.coordinates(plan.trajectory.position))).numpy()
    lowest, still = np.inf, {-1}
    for link, (parent, joint, mesh) in enumerate(zip(body.link_parent, body.joints, body.link_meshes, strict=True)):
        if int(parent) in still and (joint is None or joint.index is None):
            still.add(link)
        elif len(mesh.faces):
            heights = poses[:, link, 2, :3] @ mesh.convex_hull.vertices.T + poses[:, link, 2, 3:]
            lowest = min(lowest, float(heights.min()))
    return max(float(robot.arm.T_world_base[2, 3]) - lowest, 0.0)
