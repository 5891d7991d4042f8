"""How far a hand is from the surroundings and from the object at rest, for many poses of the hand at once."""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from jaxtyping import Float, Int

from dexnudge.geometry.warp_runtime import WarpStruct, wp
from dexnudge.hands.hand import Hand
from dexnudge.hands.kinematics import kinematic_tree
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.planning.clearance_kernel import ClearanceHand, HandStates, Obstacle, PointBalls, clearances, point_balls
from dexnudge.scenes.scene import Scene

CAP = 0.10  # [m] clearances are measured up to here; beyond, all that counts is that it is far
BATCH = 128  # states of one launch; the buffers are that long
NO_STOP = -1.0e3  # [m] below every distance: the walk goes on until the least one is found
OBSTACLES: tuple[str, str] = ("environment", "object")  # columns of what the kernel returns


@dataclass(frozen=True)
class Clearances:
    """Least signed distance of the hand's surface points to each obstacle [m], at most `CAP`; negative inside.

    `nearest`: index of the ball whose centre is that point, -1 beyond the cap. Columns as in `OBSTACLES`.
    """

    distance: Float[np.ndarray, "n 2"]
    nearest: Int[np.ndarray, "n 2"]


class HandClearance:
    """Measures clearances of one hand, its base included, in one scene; exact for the hand's dense points (2 mm).

    Signed distance, negative inside. One core; some 10 to 100 microseconds a state in free space, up to a
    millisecond where fingers surround the object.
    """

    def __init__(self, hand: Hand, scene: Scene) -> None:
        self.hand = hand
        self.count = 0
        """States measured so far: what a budget is counted in, since it is the same on every machine."""
        self.origin = scene.T_world_object[:3, 3].copy()  # single precision is finest near the object
        self._model = _model(hand)
        self._meshes: list[wp.Mesh] = []
        obstacles = [self._obstacle(mesh) for mesh in (scene.environment_mesh, scene.object_in_world())]
        links, joints = len(hand.link_names), hand.num_joints
        self._arrays = {
            "translation": np.zeros((BATCH, 3), np.float32),
            "rotation": np.zeros((BATCH, 3, 3), np.float32),
            "joint_angles": np.zeros((BATCH, joints), np.float32),
            "link_translation": np.zeros((BATCH, links, 3), np.float32),
            "link_rotation": np.zeros((BATCH, links, 3, 3), np.float32),
            "distance": np.zeros((BATCH, 2), np.float32),
            "nearest": np.zeros((BATCH, 2), np.int32),
        }
        types = {"translation": wp.vec3, "link_translation": wp.vec3, "rotation": wp.mat33, "link_rotation": wp.mat33}
        states = HandStates()
        for name, array in self._arrays.items():
            dtype = types.get(name, wp.int32 if array.dtype == np.int32 else wp.float32)
            setattr(states, name, wp.array(array, dtype=dtype, device="cpu", copy=False))
        inputs = [self._model[0], *obstacles, states, CAP, NO_STOP]
        self._launch = wp.launch(clearances, dim=BATCH, inputs=inputs, device="cpu", record_cmd=True)

    def __call__(
        self,
        translation: Float[np.ndarray, "n 3"],
        rotation: Float[np.ndarray, "n 3 3"],
        joint_angles: Float[np.ndarray, "n joint"],
        *,
        stop: float = NO_STOP,
    ) -> Clearances:
        """Return the clearances of the palm poses (world, [m]) and joint angles [rad].

        A state that comes closer than `stop` [m] is not searched further: its distance is then only known to be
        below `stop`, and that to the object may not have been looked at.
        """
        count = len(translation)
        self.count += count
        distance, nearest = np.zeros((count, 2)), np.zeros((count, 2), dtype=np.int64)
        for first in range(0, count, BATCH):
            rows = slice(first, min(first + BATCH, count))
            size = rows.stop - first
            self._arrays["translation"][:size] = translation[rows] - self.origin
            self._arrays["rotation"][:size] = rotation[rows]
            self._arrays["joint_angles"][:size] = joint_angles[rows]
            self._launch.set_dim(size)
            self._launch.set_param_at_index(5, float(stop))
            self._launch.launch()
            distance[rows] = self._arrays["distance"][:size]
            nearest[rows] = self._arrays["nearest"][:size]
        return Clearances(distance, nearest)

    def link_and_point(
        self, ball: int, T_world_palm: Float[np.ndarray, "4 4"], joint_angles: Float[np.ndarray, " joint"]
    ) -> tuple[str, Float[np.ndarray, "3"]]:
        """Return the name of the link that a ball belongs to and the place of its centre [m, world] for one state."""
        q = np.concatenate([T_world_palm[:3, 3], T_world_palm[:3, 0], T_world_palm[:3, 1], joint_angles])
        balls = self._model[1]
        link = int(balls.link[ball])
        T_world_link = self.hand.forward_kinematics(torch.as_tensor(q[None], dtype=torch.float64))[0, link].numpy()
        return self.hand.link_names[link], T_world_link[:3, :3] @ balls.point[ball] + T_world_link[:3, 3]

    def _obstacle(self, mesh: trimesh.Trimesh) -> WarpStruct:
        vertices = np.asarray(mesh.vertices - self.origin, dtype=np.float32)
        tree = wp.Mesh(
            points=wp.array(vertices, dtype=wp.vec3, device="cpu"),
            indices=wp.array(np.asarray(mesh.faces, dtype=np.int32).ravel(), dtype=wp.int32, device="cpu"),
            support_winding_number=True,
        )
        self._meshes.append(tree)  # the kernel holds only its number
        obstacle = Obstacle()
        obstacle.mesh = tree.id
        obstacle.low, obstacle.high = (wp.vec3(*end.tolist()) for end in (vertices.min(axis=0), vertices.max(axis=0)))
        return obstacle


@cached_per_instance
def _model(hand: Hand) -> tuple[WarpStruct, PointBalls]:
    """Return the hand as a struct for the kernel, and its balls for Python."""
    balls = point_balls(hand.dense_points)

    def array(values: np.ndarray, dtype: type) -> wp.array:
        return wp.array(values, dtype=dtype, device="cpu")

    model = ClearanceHand()
    model.tree = kinematic_tree(hand)
    model.point = array(balls.point, wp.vec3)
    model.radius = array(balls.radius, wp.float32)
    model.link = array(balls.link, wp.int32)
    model.following = array(balls.following, wp.int32)
    return model, balls
