"""How hands close, and where their palms face: known hands from packages, and generated ones turned and mirrored."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from dexnudge.hands.closing import closing, tip_distance
from dexnudge.hands.hand import ROOT_COORDINATES, Hand, Joint
from dexnudge.hands.registry import load_hand

KNOWN = {  # stated by those who wrote `hands/named`, seen in pictures
    "allegro": (1.0, 0.0, 0.0),
    "dex3": (0.0, 1.0, 0.0),
    "leap": (0.0, 0.0, -1.0),
    "shadow_full": (0.0, -1.0, 0.0),
    "shadow_lite": (0.0, -1.0, 0.0),
}


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
PALM = trimesh.creation.box((0.08, 0.024, 0.09))


def placed(place: tuple[float, float, float], *turns: tuple[float, tuple[float, float, float]]) -> np.ndarray:
    """Return a frame turned about the given axes, one after the other, then moved [m]."""
    transform = np.eye(4)
    for angle, axis in turns:
        transform = trimesh.transformations.rotation_matrix(angle, axis) @ transform
    return trimesh.transformations.translation_matrix(place) @ transform


def fingers(palm: trimesh.Trimesh, frames: list[np.ndarray], limits: list[tuple[float, float]]) -> Hand:
    """Return a hand of fingers of two links of 40 mm along z of their frames, both of which flex about x."""
    joints: list[Joint | None] = [None]
    links, parents, meshes, names = ["palm"], [-1], [palm], []
    for digit, frame in enumerate(frames):
        for segment, origin in enumerate((frame, placed((0, 0, 0.04)))):
            joints.append(Joint(f"j{digit}{segment}", origin, np.array(X), len(names)))
            names.append(f"j{digit}{segment}")
            parents.append(len(links) - 1 if segment else 0)
            links.append(f"l{digit}{segment}")
            meshes.append(trimesh.creation.box((0.014, 0.012, 0.036), transform=placed((0, 0, 0.022))))
    lower, upper = np.repeat(np.asarray(limits), 2, axis=0).T
    return Hand(
        name="made",
        joint_names=tuple(names),
        lower=lower,
        upper=upper,
        link_names=tuple(links),
        link_parent=np.asarray(parents),
        joints=tuple(joints),
        link_meshes=tuple(meshes),
        fingertips={f"d{digit}": f"l{digit}1" for digit in range(len(frames))},
        couplings=(),
        palm_normal=np.array((0.36, 0.48, 0.8)),
    )


def human(sign: float, turn: np.ndarray) -> Hand:
    """Return three fingers along the palm's z that curl towards -y, by positive or by negative angles, and a thumb.

    The thumb stands out of the palm's face and curls towards +z. The whole hand is turned.
    """
    flip = ((0.0 if sign > 0 else np.pi), Z)
    frames = [placed((x, 0, 0.045), flip) for x in (-0.025, 0.0, 0.025)]
    frames.append(placed((0.012, -0.012, -0.02), flip, (np.pi / 2, X)))
    finger, thumb = sorted((0.0, sign * 1.6)), sorted((0.0, -sign * 1.6))
    palm = PALM.copy()
    palm.apply_transform(turn)
    return fingers(palm, [turn @ frame for frame in frames], [tuple(finger)] * 3 + [tuple(thumb)])


def claw(count: int, limits: tuple[float, float]) -> Hand:
    """Return fingers that stand on a round palm, along z, and curl towards its middle."""
    frames = [placed((0, 0.035, 0.02)), placed((0, -0.035, 0.02), (np.pi, Z))]
    if count == 3:
        turns = [(angle, Z) for angle in np.radians((0, 120, 240))]
        frames = [placed((0, 0, 0), turn) @ placed((0, 0.04, 0.02)) for turn in turns]
    return fingers(trimesh.creation.cylinder(radius=0.05, height=0.04), frames, [limits] * count)


def clearance(hand: Hand, angles: np.ndarray) -> float:
    """Return the least distance between the vertices of any two tips' boxes, by all pairs of points [m]."""
    q = torch.zeros(1, ROOT_COORDINATES + hand.num_joints, dtype=torch.float64)
    q[0, 3] = q[0, 7] = 1.0
    q[0, ROOT_COORDINATES:] = torch.as_tensor(angles)
    poses = hand.forward_kinematics(q)[0].numpy()
    tips = [trimesh.transform_points(hand.link_meshes[link].vertices, poses[link]) for link in hand.fingertip_indices]
    pairs = [(a, b) for a in range(len(tips)) for b in range(a)]
    return min(float(np.linalg.norm(tips[a][:, None] - tips[b], axis=2).min()) for a, b in pairs)


@pytest.mark.parametrize("name", KNOWN)
def test_faces_where_the_named_hands_are_known_to_face(name: str) -> None:
    hand = replace(load_hand(name), palm_normal=np.array((0.36, 0.48, 0.8)))
    found = closing(hand)
    np.testing.assert_allclose(found.palm_normal, KNOWN[name], atol=1e-9)
    assert found.confidence > 0.8
    assert tip_distance(hand, found.closed) < 0.004 < 0.03 < tip_distance(hand, found.open)
    for pose in (found.open, found.rest, found.closed):
        assert (pose >= hand.lower - 1e-9).all()
        assert (pose <= hand.upper + 1e-9).all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("turned", [np.eye(4), trimesh.transformations.euler_matrix(0.7, -0.4, 2.1)])
def test_a_hand_in_any_frame_and_with_either_sign_of_flexion(sign: float, turned: np.ndarray) -> None:
    found = closing(human(sign, turned))
    np.testing.assert_allclose(found.palm_normal, turned[:3, :3] @ (0.0, -1.0, 0.0), atol=1e-6)
    assert found.confidence > 0.7
    assert (sign * found.closed[:6] > 0.1).all()  # curled, all three


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("limits", [(-0.5, 1.3), (-1.4, 1.4)])
def test_fingers_around_a_palm_point_where_it_faces(count: int, limits: tuple[float, float]) -> None:
    hand = claw(count, limits)
    found = closing(hand)
    np.testing.assert_allclose(found.palm_normal, (0.0, 0.0, 1.0), atol=1e-6)
    assert found.confidence > 0.7
    assert clearance(hand, found.closed) < clearance(hand, found.open)


def test_digits_that_never_meet_leave_doubt() -> None:
    frames = [placed((0, 0.03, 0.02)), placed((0.02, 0.03, 0.02), (1.0, Z)), placed((0, -0.03, -0.02), (np.pi, Y))]
    assert closing(fingers(PALM, frames, [(-0.6, 0.6)] * 3)).confidence < 0.5
