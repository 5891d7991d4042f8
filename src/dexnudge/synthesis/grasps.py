"""Grasps by DexGraspNet's energy: force closure, distance, penetration, self-penetration, limits (Wang et al., ICRA 2023).

E_fc = |sum n_i|^2 + |sum (p_i x n_i) / half_length|^2 over the contacts, n_i the object's normal at the contact; its
gradient acts on the contacts' positions. The other terms are those of the fused kernel; limits and couplings hold by
construction. The starts oppose the thumb to the other digits across the object, which the frictionless E_fc alone rarely
finds on a slab.
"""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from torch import Tensor

from dexnudge.energies import HandEnergy, HandPose
from dexnudge.energies.descent import HandDescent, StepSizes, configuration_from_pose
from dexnudge.energies.weights import TermWeights
from dexnudge.geometry.surface_points import SurfacePoints
from dexnudge.geometry.warp_runtime import WarpStruct
from dexnudge.hands.hand import Hand
from dexnudge.synthesis.pre_contact import random_joint_angles

WIDEST_GRASP = 0.085  # [m] between thumb and fingers
OPPOSING = -0.8  # largest cosine between the normals on the two sides
SPREAD = 0.02  # [m] between neighbouring fingers on their side
FINGER_COUNTS = {1: 0.2, 2: 0.4, 3: 0.4}  # digits that oppose the thumb


@dataclass(frozen=True)
class GraspConfig:
    """Budget and weights of the descent."""

    batch: int = 256
    steps: int = 160
    final_scale: float = 0.05
    step_sizes: StepSizes = StepSizes(translation=0.003, rotation=0.03, joints=0.05)
    weights: TermWeights = TermWeights(contact=8.0, target=1.0)
    reach_share: float = 0.3  # of the steps that also reach for the targets
    force_closure: float = 2.0e-4  # weight of E_fc against the squared distances [m^2]


def descend_to_grasp(
    hand: Hand,
    fields: WarpStruct,
    surface: SurfacePoints,
    object_mesh: trimesh.Trimesh,
    centre_of_mass: Float[np.ndarray, " 3"],
    *,
    config: GraspConfig,
    generator: np.random.Generator,
) -> Float[Tensor, "batch coordinates"]:
    """A batch of grasps q in the frame of the object's mesh, at the end of the descent, checked by nobody yet."""
    pose, target, touches = opposing_starts(hand, surface, config.batch, generator)
    energy = HandEnergy(hand, fields, config.batch, config.weights)
    tips = [hand.link_names.index(link) for link in hand.fingertip_links]
    energy.target[:, tips] = target
    energy.target_weight[:, tips] = touches
    energy.contact_weight[:, tips] = touches
    descent = HandDescent(hand, config.batch, steps=config.step_sizes)
    centre = torch.as_tensor(centre_of_mass, dtype=torch.float32)
    half_length = float(np.max(object_mesh.extents)) / 2
    for step in range(config.steps):
        if step == int(config.reach_share * config.steps):
            energy.target_weight.zero_()
        energy(pose)
        energy.extra_force[:, tips] = config.force_closure * force_closure_gradient(
            energy.contact_point[:, tips] - centre, energy.contact_normal[:, tips], touches, half_length
        )
        pose = descent.step(pose, energy.gradient, scale=config.final_scale ** (step / config.steps))
    return configuration_from_pose(pose)


def force_closure_gradient(
    arms: Float[Tensor, "batch digit 3"],
    normals: Float[Tensor, "batch digit 3"],
    touches: Float[Tensor, "batch digit"],
    half_length: float,
) -> Float[Tensor, "batch digit 3"]:
    """Gradient of E_fc in the contacts' positions [1/m]; the normals are held fixed."""
    weighted = normals * touches[..., None]
    torque = torch.linalg.cross(arms, weighted).sum(dim=1, keepdim=True) / half_length
    return 2.0 / half_length * torch.linalg.cross(weighted, torque.expand_as(weighted))


def opposing_starts(
    hand: Hand, surface: SurfacePoints, count: int, generator: np.random.Generator
) -> tuple[HandPose, Float[Tensor, "count digit 3"], Float[Tensor, "count digit"]]:
    """Hands whose thumb and fingers stand on opposite sides; targets on the surface [m]; which digits touch."""
    digits, thumb = len(hand.fingertips), hand.thumb
    fingers = [digit for digit in range(digits) if digit != thumb]
    target, touches = np.zeros((count, digits, 3)), np.zeros((count, digits), dtype=np.float32)
    sides = opposing_sides(surface, count, generator)
    for item, (one, two) in enumerate(sides):
        number = generator.choice(list(FINGER_COUNTS), p=list(FINGER_COUNTS.values()))
        chosen = np.sort(generator.permutation(fingers)[:number])
        touches[item, [thumb, *chosen]] = 1.0
        across = surface.points[two] - surface.points[one]
        along = np.cross(across, generator.normal(size=3))
        along /= max(np.linalg.norm(along), 1e-9)
        target[item, thumb] = surface.points[one]
        for place, digit in enumerate(chosen):
            target[item, digit] = surface.points[two] + (place - (number - 1) / 2) * SPREAD * along
    joint_angles = random_joint_angles(hand, count, generator)
    q = torch.zeros(count, 9 + hand.num_joints)
    q[:, 3], q[:, 7], q[:, 9:] = 1.0, 1.0, joint_angles
    tips = hand.keypoints(q).numpy().astype(np.float64)
    rotation, translation = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for item in range(count):
        used = touches[item] > 0
        others = used & (np.arange(digits) != thumb)
        goal = target[item, others].mean(axis=0) - target[item, thumb]
        have = tips[item, others].mean(axis=0) - tips[item, thumb]
        align = trimesh.geometry.align_vectors(have, goal)[:3, :3]
        roll = trimesh.transformations.rotation_matrix(generator.uniform(0, 2 * np.pi), goal)[:3, :3]
        rotation[item] = roll @ align
        middle = 0.5 * (target[item, others].mean(axis=0) + target[item, thumb])
        own = 0.5 * (tips[item, others].mean(axis=0) + tips[item, thumb])
        translation[item] = middle - rotation[item] @ own
    pose = HandPose(_tensor(translation), _tensor(rotation), joint_angles)
    return pose, _tensor(target), torch.as_tensor(touches)


def opposing_sides(surface: SurfacePoints, count: int, generator: np.random.Generator) -> np.ndarray:
    """Pairs (count, 2) of points whose normals oppose each other along the line between them, nearest lines first."""
    points, normals = surface.points, surface.normals
    first = generator.integers(len(points), size=count)
    second = np.zeros(count, dtype=np.int64)
    for item, one in enumerate(first):
        across = points - points[one]
        distance = np.maximum(np.linalg.norm(across, axis=1), 1e-9)
        facing = (normals @ normals[one] < OPPOSING) & (distance < WIDEST_GRASP)
        straight = -(across @ normals[one]) / distance
        straight[~facing] = -1.0
        second[item] = int(np.argmax(straight))
    return np.stack([first, second], axis=1)


def _tensor(values: np.ndarray) -> Tensor:
    return torch.as_tensor(values, dtype=torch.float32)
