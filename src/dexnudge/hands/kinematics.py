"""A hand's links and joints as the arrays that kernels read."""

from functools import partial

import numpy as np

from dexnudge.geometry.warp_runtime import WarpStruct, wp
from dexnudge.hands.hand import Hand

# Warp's own language: its annotations are no Python types.
# mypy: disable-error-code="misc, no-untyped-def, valid-type"


@wp.struct
class KinematicTree:
    """A hand's links and joints; parents stand before their children."""

    parent: wp.array(dtype=int)  # (L,) -1 for the root
    joint: wp.array(dtype=int)  # (L,) index of the joint angle, -1 where fixed
    multiplier: wp.array(dtype=float)  # (L,)
    offset: wp.array(dtype=float)  # (L,) [rad], [m] where the joint slides
    slides: wp.array(dtype=int)  # (L,) 1 where the joint slides along its axis, 0 where it turns about it
    axis: wp.array(dtype=wp.vec3)  # (L,)
    origin_rotation: wp.array(dtype=wp.mat33)  # (L,)
    origin_translation: wp.array(dtype=wp.vec3)  # (L,) [m]


@wp.func
def place_links(
    tree: KinematicTree,
    root_rotation: wp.mat33,
    root_translation: wp.vec3,
    joint_angles: wp.array2d(dtype=float),
    i: int,
    link_rotation: wp.array2d(dtype=wp.mat33),
    link_translation: wp.array2d(dtype=wp.vec3),
):
    """Compute the pose of every link of hand i in the frame of its root's pose."""
    for l in range(tree.parent.shape[0]):
        if tree.parent[l] < 0:
            link_rotation[i, l] = root_rotation
            link_translation[i, l] = root_translation
        else:
            above = link_rotation[i, tree.parent[l]]
            rotation = above * tree.origin_rotation[l]
            translation = link_translation[i, tree.parent[l]] + above * tree.origin_translation[l]
            if tree.joint[l] >= 0:
                angle = tree.multiplier[l] * joint_angles[i, tree.joint[l]] + tree.offset[l]
                if tree.slides[l] > 0:
                    translation = translation + rotation * (angle * tree.axis[l])
                else:
                    rotation = rotation * wp.quat_to_matrix(wp.quat_from_axis_angle(tree.axis[l], angle))
            link_rotation[i, l] = rotation
            link_translation[i, l] = translation


def kinematic_tree(hand: Hand, *, device: str = "cpu") -> WarpStruct:
    """Return the `KinematicTree` of a hand, in single precision."""
    joints = hand.joints
    origins = np.stack([np.eye(4) if joint is None else joint.origin for joint in joints])
    array = partial(wp.array, device=device)
    tree = KinematicTree()
    tree.parent = array(hand.link_parent, wp.int32)
    tree.joint = array([-1 if j is None or j.index is None else j.index for j in joints], wp.int32)
    tree.multiplier = array([1.0 if j is None else j.multiplier for j in joints], wp.float32)
    tree.offset = array([0.0 if j is None else j.offset for j in joints], wp.float32)
    tree.slides = array([0 if j is None else int(j.slides) for j in joints], wp.int32)
    tree.axis = array(np.stack([np.zeros(3) if j is None else j.axis for j in joints]), wp.vec3)
    tree.origin_rotation = array(origins[:, :3, :3], wp.mat33)
    tree.origin_translation = array(origins[:, :3, 3], wp.vec3)
    return tree
