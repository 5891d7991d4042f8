"""DexGraspNet's starts: hands far around the object, palms towards it, joints about a canonical pose."""

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from scipy.stats import truncnorm

from dexnudge.energies.descent import HandPose
from dexnudge.hands.hand import ROOT_COORDINATES, Hand

INFLATION = 0.2  # [m] by which the object's convex hull grows
BACK_OFF = (0.2, 0.3)  # [m] from the grown hull to the palm's origin
CONE = np.pi / 6  # [rad] largest deviation of the approach from the object's nearest point
PALM_TO_FINGERS = np.pi / 3  # [rad] of the approach direction from the fingers' towards the palm's normal
JOINT_SPREAD = 0.1  # standard deviation of the joint angles over their range
CANDIDATES = 100  # points on the grown hull per start, of which the farthest from each other are taken
# [rad] by the Shadow Hand's joint names; joints that are not named here start about zero.
CANONICAL = {"FFJ4": -0.1, "RFJ4": -0.1, "FFJ2": 0.6, "MFJ2": 0.6, "RFJ2": 0.6, "LFJ2": 0.6, "THJ4": 1.2, "THJ2": -0.2}


def annealing_starts(hand: Hand, object_mesh: trimesh.Trimesh, count: int, generator: np.random.Generator) -> HandPose:
    """`count` starts in the frame of the object's mesh."""
    hull = object_mesh.convex_hull
    middle = hull.bounds.mean(axis=0)
    away = hull.vertices - middle
    away += INFLATION * away / np.linalg.norm(away, axis=1, keepdims=True)
    grown = trimesh.convex.convex_hull(middle + away)
    offered, _ = trimesh.sample.sample_surface(grown, CANDIDATES * count, seed=generator)
    places = farthest_points(np.asarray(offered), count)
    nearest, _, _ = trimesh.proximity.closest_point(hull, places)
    towards = (nearest - places) / np.linalg.norm(nearest - places, axis=1, keepdims=True)

    deviation, around, roll = generator.uniform([-CONE, 0, 0], [CONE, 2 * np.pi, 2 * np.pi], (count, 3)).T
    back = generator.uniform(*BACK_OFF, count)
    palm = hand.palm_normal / np.linalg.norm(hand.palm_normal)
    approach = np.cos(PALM_TO_FINGERS) * hand.finger_axis + np.sin(PALM_TO_FINGERS) * palm
    rotation, translation = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for item in range(count):
        aside = np.cross(towards[item], np.eye(3)[int(np.argmin(np.abs(towards[item])))])
        aside = _turn(around[item], towards[item]) @ (aside / np.linalg.norm(aside))
        wanted = _turn(deviation[item], aside) @ towards[item]
        rotation[item] = _turn(roll[item], wanted) @ trimesh.geometry.align_vectors(approach, wanted)[:3, :3]
        translation[item] = places[item] - back[item] * wanted
    q = torch.zeros(count, ROOT_COORDINATES + hand.num_joints)
    q[:, ROOT_COORDINATES:] = torch.as_tensor(_joint_angles(hand, count, generator), dtype=torch.float32)
    return HandPose(
        torch.as_tensor(translation, dtype=torch.float32),
        torch.as_tensor(rotation, dtype=torch.float32),
        hand.clamp(q)[:, ROOT_COORDINATES:],
    )


def farthest_points(points: Float[np.ndarray, "n 3"], count: int) -> Float[np.ndarray, "kept 3"]:
    """`count` of the points, or all if there are fewer, each the farthest from those before it."""
    chosen = [0]
    apart = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return points[chosen]


def _joint_angles(hand: Hand, count: int, generator: np.random.Generator) -> Float[np.ndarray, "count joint"]:
    mean = np.clip([CANONICAL.get(name, 0.0) for name in hand.joint_names], hand.lower, hand.upper)
    spread = JOINT_SPREAD * (hand.upper - hand.lower)
    low, high = (hand.lower - mean) / spread, (hand.upper - mean) / spread
    size = (count, hand.num_joints)
    return np.asarray(truncnorm.rvs(low, high, loc=mean, scale=spread, size=size, random_state=generator))


def _turn(angle: float, axis: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    return trimesh.transformations.rotation_matrix(angle, axis)[:3, :3]
