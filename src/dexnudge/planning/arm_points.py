"""Whether an arm's links stand in the surroundings, by points on them: blind only for what fits between points."""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from dexnudge.arms.arm import Arm
from dexnudge.arms.inverse_kinematics import Chain
from dexnudge.hands.tree import chain_to
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.placement import surroundings_distance
from dexnudge.scenes.scene import Scene

PER_LINK = 60  # points on a link: about 4 cm apart on a Panda's
SEED = 0  # of their places


@dataclass(frozen=True)
class ArmPoints:
    """Points on the links that move. joint: whose motion each follows. place: in the frame behind that joint [m]."""

    joint: Int[np.ndarray, " point"]
    place: Float[np.ndarray, "point 3"]

    def blocked(
        self,
        chain: Chain,
        scene: Scene,
        positions: Float[np.ndarray, "row n"],
        T_world_base: Float[np.ndarray, "#row 4 4"],
    ) -> Bool[np.ndarray, " row"]:
        """Return at which joint angles a point is inside the surroundings."""
        inside = np.zeros(len(positions), dtype=bool)
        if not len(self.place) or not len(positions):
            return inside
        frames, bounds = T_world_base[:, None] @ chain.frames(positions), scene.environment_mesh.bounds
        for joint in np.unique(self.joint):
            own = frames[:, joint]
            points = self.place[self.joint == joint] @ own[:, :3, :3].swapaxes(1, 2) + own[:, None, :3, 3]
            row, point = np.nonzero(((points > bounds[0]) & (points < bounds[1])).all(axis=2))
            if len(row):
                deep = surroundings_distance(scene.environment_mesh)(points[row, point]).distance < 0
                inside[row[deep]] = True
        return inside


@cached_per_instance
def arm_points(arm: Arm) -> ArmPoints:
    """Return points spread over the links between base and flange; the same every time."""
    moving = [joint.name for joint in arm.chain if not joint.fixed]
    joints, places = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    for link, mesh in arm.tree.links.items():
        pose, above = np.eye(4), chain_to(arm.tree, link)
        while above and above[-1].fixed:
            pose = above.pop().origin @ pose
        if above and above[-1].name in moving and len(mesh.faces):
            drawn = np.asarray(trimesh.sample.sample_surface(mesh, PER_LINK, seed=SEED)[0])
            places.append(trimesh.transform_points(drawn, pose))
            joints.append(np.full(len(drawn), moving.index(above[-1].name)))
    return ArmPoints(np.concatenate(joints), np.concatenate(places))
