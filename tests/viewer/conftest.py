"""A recording whose every number is known, and hands of boxes, of any size and handedness, in any frame."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from dexnudge.hands.hand import Hand, Joint
from dexnudge.viewer.recording import Curve, Recording
from dexnudge.viewer.visual_scene import Part, VisualScene

DIGITS = {"index": 0.03, "middle": 0.0, "ring": -0.03, "thumb": 0.045}  # x of the first joint [m]


@pytest.fixture(scope="session")
def recording() -> Recording:
    """A block that rests for 1 s, then slides 100 mm along x in 1 s and turns by 0.1 rad; 41 moments.

    A fingertip follows 80 mm behind it; the arrow is there up to 1.5 s.
    """
    block, tip = trimesh.creation.box((0.1, 0.06, 0.02)), trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    floor = trimesh.creation.box(bounds=[[-0.3, -0.3, -0.03], [0.4, 0.3, -0.01]])
    time = np.linspace(0.0, 2.0, 41)
    frames = []
    for now in time:
        slid = 0.1 * max(0.0, now - 1.0)
        T_world_block = trimesh.transformations.rotation_matrix(slid, [0, 0, 1])
        T_world_block[0, 3] = slid
        T_world_tip = trimesh.transformations.translation_matrix([slid - 0.08, 0.0, 0.02])
        parts = (
            Part("object", "object", block, T_world_block),
            Part("environment", "environment", floor, np.eye(4)),
            Part("tip", "fingertip", tip, T_world_tip),
        )
        motion = np.array([1.0, 0, 0]) if now <= 1.5 else np.zeros(3)
        frames.append(VisualScene(parts, np.zeros((0, 3)), motion, arrow_length=0.1, arrow_from=np.eye(4)))
    charts = {
        "way": (
            Curve("along", "mm", 100.0 * np.maximum(time - 1.0, 0.0)),
            Curve("up", "mm", np.full(41, -1e-9)),
        ),
        "force": (Curve("normal", "N", np.where(time < 0.99, np.nan, 3.0 + time)),),
    }
    return Recording(frames, time, ["wait" if now < 0.99 else "push" for now in time], charts, "block", "success")


@pytest.fixture(scope="session")
def toy_hand() -> Callable[..., Hand]:
    """Hands of eight joints: toy_hand(size=1.0, mirrored=False, T_palm_toy=None, name="toy")."""
    return _toy_hand


@pytest.fixture(scope="session")
def toy_gripper() -> Hand:
    """A gripper of two jaws."""
    return _toy_gripper()


def _at(*translation):
    return trimesh.transformations.translation_matrix(translation)


def _toy_hand(*, size=1.0, mirrored=False, T_palm_toy=None, name="toy"):
    """A palm in the x-z plane that faces -y, three fingers along z and a thumb towards x; 8 joints.

    size: factor on all lengths; mirrored: the thumb towards -x; T_palm_toy: rotation of all that within the palm's frame.
    """
    side = -1.0 if mirrored else 1.0
    frame = np.eye(4) if T_palm_toy is None else T_palm_toy
    names, parents, joints, meshes = ["palm"], [-1], [None], [_box((0.08, 0.02, 0.09), (0, 0, 0.045), size, frame)]
    for digit, x in DIGITS.items():
        thumb = digit == "thumb"
        turn = trimesh.transformations.rotation_matrix(side * np.pi / 3 if thumb else 0.0, [0, 1, 0])
        place = _at(side * x * size, 0, (0.03 if thumb else 0.09) * size) @ turn
        for part, (origin, length) in enumerate(((place, 0.05), (_at(0, 0, 0.05 * size), 0.03))):
            axis = frame[:3, :3] @ [1.0, 0, 0]
            local = frame @ origin @ np.linalg.inv(frame)
            joints.append(Joint(f"{digit}{part}", local, axis, len(joints) - 1))
            parents.append(len(names) - 1 if part else 0)
            names.append(f"{digit}{part}")
            # A little aside, so that one corner is farthest.
            meshes.append(_box((0.016, 0.014, length), (1e-3, 5e-4, length / 2), size, frame))
    return Hand(
        name=name,
        joint_names=tuple(names[1:]),
        lower=np.full(8, -0.3),
        upper=np.full(8, 1.5),
        link_names=tuple(names),
        link_parent=np.asarray(parents),
        joints=tuple(joints),
        link_meshes=tuple(meshes),
        fingertips={digit: f"{digit}1" for digit in DIGITS},
        couplings=(("index1", "index0"),),
        palm_normal=frame[:3, :3] @ [0.0, -2.0, 0.0],
    )


def _toy_gripper():
    """A block whose palm faces z, where its two jaws point, that turn about x; 2 joints."""
    jaws = [Joint(f"jaw{k}", _at(0, y, 0.03), np.array([y / 0.03, 0, 0]), k) for k, y in enumerate((-0.03, 0.03))]
    jaw = trimesh.creation.box((0.02, 0.006, 0.06), _at(0, 0, 0.03))
    return Hand(
        name="gripper",
        joint_names=("jaw0", "jaw1"),
        lower=np.array([-0.5, -0.5]),
        upper=np.array([0.4, 0.4]),
        link_names=("palm", "jaw0", "jaw1"),
        link_parent=np.array([-1, 0, 0]),
        joints=(None, *jaws),
        link_meshes=(trimesh.creation.box((0.04, 0.08, 0.06)), jaw, jaw),
        fingertips={"one": "jaw0", "other": "jaw1"},
        couplings=(),
        palm_normal=np.array([0.0, 0.0, 1.0]),
    )


def _box(extents, centre, size, frame):
    mesh = trimesh.creation.box(size * np.asarray(extents), _at(*(size * np.asarray(centre))))
    return mesh.apply_transform(frame)
