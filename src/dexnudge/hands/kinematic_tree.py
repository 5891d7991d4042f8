"""A hand's links and joints as the arrays that kernels read."""

import numpy as np

from dexnudge.geometry.warp_runtime import WarpStruct, wp
from dexnudge.hands.hand import Hand
from dexnudge.hands.kinematics_kernel import KinematicTree


def kinematic_tree(hand: Hand, *, device: str = "cpu") -> WarpStruct:
    """The `KinematicTree` of a hand, in single precision."""
    joints = hand.joints
    origins = np.stack([np.eye(4) if joint is None else joint.origin for joint in joints])

    def array(values: np.ndarray | list, dtype: type) -> wp.array:
        return wp.array(np.asarray(values), dtype=dtype, device=device)

    tree = KinematicTree()
    tree.parent = array(hand.link_parent, wp.int32)
    tree.joint = array([-1 if j is None or j.index is None else j.index for j in joints], wp.int32)
    tree.multiplier = array([1.0 if j is None else j.multiplier for j in joints], wp.float32)
    tree.offset = array([0.0 if j is None else j.offset for j in joints], wp.float32)
    tree.axis = array(np.stack([np.zeros(3) if j is None else j.axis for j in joints]), wp.vec3)
    tree.origin_rotation = array(origins[:, :3, :3], wp.mat33)
    tree.origin_translation = array(origins[:, :3, 3], wp.vec3)
    return tree
