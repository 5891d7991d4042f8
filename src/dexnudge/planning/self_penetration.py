"""How deep a hand's links are in one another, by exact distance, for the joint angles of an opening hand."""

import numpy as np
import torch
import trimesh
from jaxtyping import Float

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.hands.hand import ROOT_COORDINATES, Hand


class SelfPenetration:
    """Measures one hand; made once for it."""

    def __init__(self, hand: Hand) -> None:
        self.hand = hand
        dense = hand.dense_points
        pairs = hand.self_collision_pairs
        self._pairs = [*pairs, *((other, one) for one, other in pairs)]
        links = {link for pair in self._pairs for link in pair}
        self._points = {link: dense.points[dense.link == link] for link in links}
        self._bounds = {link: hand.link_meshes[link].bounds for link in links}
        self._solids = {link: ExactDistance(hand.link_meshes[link]) for link in links}

    def __call__(self, joint_angles: Float[np.ndarray, "n joint"]) -> Float[np.ndarray, " n"]:
        """Depth of the deepest point of any link in a link that it must not touch [m]; 0 where none is inside."""
        q = np.zeros((len(joint_angles), ROOT_COORDINATES + self.hand.num_joints))
        q[:, 3] = q[:, 7] = 1.0
        q[:, ROOT_COORDINATES:] = joint_angles
        T = self.hand.forward_kinematics(torch.as_tensor(q)).numpy()
        deepest = np.zeros(len(joint_angles))
        for solid, other in self._pairs:
            T_solid_other = np.linalg.inv(T[:, solid]) @ T[:, other]
            low, high = self._bounds[solid]
            own_low, own_high = self._bounds[other]
            corners = trimesh.bounds.corners((own_low, own_high))
            placed = np.einsum("nij,kj->nki", T_solid_other[:, :3, :3], corners) + T_solid_other[:, None, :3, 3]
            rows = np.flatnonzero(((placed.min(axis=1) < high) & (placed.max(axis=1) > low)).all(axis=1))
            if len(rows) == 0:
                continue
            local = self._points[other] @ np.swapaxes(T_solid_other[rows, :3, :3], 1, 2)
            local += T_solid_other[rows, None, :3, 3]
            row, point = np.nonzero(((local > low) & (local < high)).all(axis=2))
            if len(row):
                np.maximum.at(deepest, rows[row], -self._solids[solid](local[row, point]).distance)
        return deepest
