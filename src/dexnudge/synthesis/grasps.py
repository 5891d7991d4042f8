"""Grasps by descent from starts that oppose the thumb to the other digits across the object.

DexGraspNet (Wang et al., ICRA 2023) finds grasps by annealing an energy whose force closure, the length of the sum of
wrenches of unit normals, knows no friction. On a slab it rarely makes thumb and fingers oppose each other, and it moves
hands apart that do. Here thumb and fingers oppose each other from the start, and their targets on the surface do as well.
The descent brings the hand there without penetration (the fused kernel's terms; limits and couplings hold by construction),
and verification decides what holds. `benchmarks/grasps.py` compares the two.
"""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dexnudge.energies.descent import HandDescent, HandPose, StepSizes, configuration_from_pose
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.terms import TermWeights
from dexnudge.geometry.surface_points import SurfacePoints
from dexnudge.geometry.warp_runtime import WarpStruct
from dexnudge.hands.hand import Hand
from dexnudge.synthesis.nonprehensile import random_joint_angles

WIDEST_GRASP = 0.085  # [m] between thumb and fingers
NARROWEST_GRASP = 1.0e-4  # [m] under which two points are the same place and have no line between them
OPPOSING = -0.8  # largest cosine between the normals on the two sides
SPREAD = 0.02  # [m] between neighbouring fingers on their side
FINGER_COUNTS = {1: 0.2, 2: 0.4, 3: 0.4}  # digits that oppose the thumb
NEAR_CENTRE = 0.025  # [m] spread of the thumb about the centre of mass: a pinch far from it lets the object turn


@dataclass(frozen=True)
class GraspConfig:
    """Budget and weights of the descent.

    `starts` poses are tried for each grasp and the one of least energy descends. Until `reach_share` of the steps the
    digits also reach for their targets.
    """

    batch: int = 256
    starts: int = 8
    steps: int = 160
    final_scale: float = 0.05
    step_sizes: StepSizes = StepSizes(translation=0.003, rotation=0.03, joints=0.05)
    weights: TermWeights = TermWeights(
        object=8.0, self=8.0, contact=8.0, target=1.0, clearance_object=0.0005, contact_gap=0.0007
    )
    reach_share: float = 0.5


@dataclass(frozen=True)
class GraspTargets:
    """Where each digit is to touch the surface [m] and which digits do; the thumb is always among them."""

    places: Float[Tensor, "batch digit 3"]
    touches: Float[Tensor, "batch digit"]


def descend_to_grasp(
    hand: Hand,
    fields: WarpStruct,
    surface: SurfacePoints,
    centre_of_mass: Float[np.ndarray, " 3"],
    *,
    config: GraspConfig,
    generator: np.random.Generator,
) -> Float[Tensor, "batch coordinates"]:
    """Return grasps q in the frame of the object's mesh at the end of the descent, not yet verified.

    Joints that share a tendon turn alike: under load a tendon-driven finger comes to rest there,
    see `Hand.equalise_tendon_joints`.
    """
    targets = opposing_targets(hand, surface, centre_of_mass, config.batch, generator)
    energy = HandEnergy(hand, fields, config.batch, config.weights)
    tips = hand.fingertip_indices
    energy.target[:, tips] = targets.places
    energy.target_weight[:, tips] = targets.touches
    energy.contact_weight[:, tips] = targets.touches
    pose = _best_start(hand, energy, targets, config.starts, generator)
    descent = HandDescent(hand, config.batch, steps=config.step_sizes, tied=True)
    for step in range(config.steps):
        if step == int(config.reach_share * config.steps):
            energy.target_weight.zero_()
        energy(pose)
        pose = descent.step(pose, energy.gradient, scale=config.final_scale ** (step / config.steps))
    return configuration_from_pose(pose)


def _best_start(
    hand: Hand, energy: HandEnergy, targets: GraspTargets, starts: int, generator: np.random.Generator
) -> HandPose:
    """For each hand the one of its random starts with the least energy."""
    best = opposing_pose(hand, targets, generator)
    least = energy(best).clone()
    for _ in range(starts - 1):
        pose = opposing_pose(hand, targets, generator)
        total = energy(pose)
        better = total < least
        for ours, other in zip(vars(best).values(), vars(pose).values(), strict=True):
            ours[better] = other[better]
        least = torch.minimum(least, total)
    return best


def opposing_targets(
    hand: Hand,
    surface: SurfacePoints,
    centre_of_mass: Float[np.ndarray, " 3"],
    count: int,
    generator: np.random.Generator,
) -> GraspTargets:
    """Return targets with the thumb on one side of the object, one to three fingers in a row on the side that faces it."""
    digits, thumb = len(hand.fingertips), hand.thumb
    fingers = [digit for digit in range(digits) if digit != thumb]
    places, touches = np.zeros((count, digits, 3)), np.zeros((count, digits))
    for item, (one, two) in enumerate(opposing_sides(surface, centre_of_mass, count, generator)):
        number = min(generator.choice(list(FINGER_COUNTS), p=list(FINGER_COUNTS.values())), len(fingers))
        chosen = np.sort(generator.permutation(fingers)[:number])
        touches[item, [thumb, *chosen]] = 1.0
        across = surface.points[two] - surface.points[one]
        along = np.cross(across, generator.normal(size=3))
        along /= max(np.linalg.norm(along), 1e-9)
        places[item, thumb] = surface.points[one]
        for place, digit in enumerate(chosen):
            places[item, digit] = surface.points[two] + (place - (number - 1) / 2) * SPREAD * along
    return GraspTargets(_tensor(places), _tensor(touches))


def opposing_pose(hand: Hand, targets: GraspTargets, generator: np.random.Generator) -> HandPose:
    """Return hands with random joint angles whose thumb and fingers are on their targets' sides, rolled at random."""
    places, touches = targets.places.numpy().astype(np.float64), targets.touches.numpy() > 0
    count = len(places)
    q = torch.zeros(count, 9 + hand.num_joints)
    q[:, 3], q[:, 7], q[:, 9:] = 1.0, 1.0, random_joint_angles(hand, count, generator)
    q = hand.equalise_tendon_joints(q)
    tips = hand.keypoints(q).numpy().astype(np.float64)
    rotation, translation = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for item in range(count):
        target_thumb, target_fingers = _two_sides(hand, places[item], touches[item])
        thumb, fingers = _two_sides(hand, tips[item], touches[item])
        roll = trimesh.transformations.rotation_matrix(generator.uniform(0, 2 * np.pi), target_fingers - target_thumb)
        align = trimesh.geometry.align_vectors(fingers - thumb, target_fingers - target_thumb)
        rotation[item] = roll[:3, :3] @ align[:3, :3]
        translation[item] = 0.5 * (target_thumb + target_fingers) - rotation[item] @ (0.5 * (thumb + fingers))
    return HandPose(_tensor(translation), _tensor(rotation), q[:, 9:])


def _two_sides(
    hand: Hand, places: Float[np.ndarray, "digit 3"], touches: Bool[np.ndarray, " digit"]
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """The thumb's place and the mean of the other digits that touch [m]."""
    fingers = touches & (np.arange(len(places)) != hand.thumb)
    return places[hand.thumb], places[fingers].mean(axis=0)


def opposing_sides(
    surface: SurfacePoints, centre_of_mass: Float[np.ndarray, " 3"], count: int, generator: np.random.Generator
) -> Int[np.ndarray, "count 2"]:
    """Return pairs of points, the first near the centre of mass, whose normals oppose each other along their line."""
    points, normals = surface.points, surface.normals
    likely = np.exp(-0.5 * (np.linalg.norm(points - centre_of_mass, axis=1) / NEAR_CENTRE) ** 2)
    first = generator.choice(len(points), size=count, p=likely / likely.sum())
    second = np.zeros(count, dtype=np.int64)
    for item, one in enumerate(first):
        across = points - points[one]
        distance = np.linalg.norm(across, axis=1)
        usable = (distance > NARROWEST_GRASP) & (distance < WIDEST_GRASP)
        straight = np.where(usable, -(across @ normals[one]) / np.maximum(distance, NARROWEST_GRASP), -1.0)
        facing = usable & (normals @ normals[one] < OPPOSING)
        straight[~facing] -= 1.0  # where no place faces this one, the straightest of the others
        second[item] = int(np.argmax(np.where(usable, straight, -np.inf)))
    return np.stack([first, second], axis=1)


def _tensor(values: np.ndarray) -> Tensor:
    return torch.as_tensor(values, dtype=torch.float32)
