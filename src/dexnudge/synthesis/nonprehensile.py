"""Non-prehensile configurations by Eq. 1: start before the object, reach for points of its surface, then touch them.

Paper III-A: starts are pre-contact poses from which a subset of the digits could push, press or hook an object that lies on
a plane. The targets are chosen for a direction of motion, so that the object can move: on the trailing side (push, hook) or
on top (press), on both sides of the line through the centre of mass where several digits touch.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from dexnudge.energies.descent import HandDescent, HandPose, StepSizes, configuration_from_pose
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.terms import TermWeights
from dexnudge.geometry.surface_points import SurfacePoints
from dexnudge.geometry.warp_runtime import WarpStruct
from dexnudge.hands.hand import Hand
from dexnudge.verification.penetration import self_penetration

TOP_NORMAL = 0.9  # smallest vertical part of a normal on which one presses
SIDE_NORMAL = 0.8  # smallest part of a side normal against the motion
INTENTS = {"press": 0.3, "push": 0.35, "hook": 0.35}  # shares of the starts; many side starts end on top, as presses
UPRIGHT_INTENTS = {"press": 0.3, "push": 0.25, "hook": 0.45}  # of one that stands: hooks over its top need most tries
UPRIGHT_SPREAD = 20.0  # [deg] standard deviation of the direction about one across the object's sides
HIGHEST_REACH = 0.8  # share of the height of an object that stands above which all targets may lie
HOOK_SPREAD = 40.0  # [deg] standard deviation of a hooking hand's heading about the one against the motion
DIGIT_COUNTS = {1: 0.15, 2: 0.40, 3: 0.30, 4: 0.15}  # how many digits are to touch
DIGIT_SPREAD = 0.022  # [m] between neighbouring knuckles
LATERAL_SPREAD = 0.010  # [m] of the contacts' middle about the line through the centre of mass
ABOVE_SUPPORT = 0.002  # [m] lowest point of a start: what is pushed out of the support is pushed into other fingers
STANDOFF = (0.004, 0.020)  # [m] from the targets, along the mean surface normal
PITCH = (-10.0, 75.0)  # [deg] of the fingers below the horizontal
ROLL_SPREAD = 25.0  # [deg] standard deviation about the finger direction
ABDUCTION_SPREAD = 0.15  # standard deviation, as a share of the joint's range
INTERLOCKED = 0.003  # [m] the descent rarely parts links that are deeper in each other
MOST_DRAWS = 12  # of joint angles for one start


@dataclass(frozen=True)
class NonPrehensileConfig:
    """Budget and weights of Eq. 1's descent.

    The first `reach_steps` follow both terms of Eq. 1, the others only the touch; step sizes shrink to `final_scale`.
    """

    batch: int = 256
    reach_steps: int = 50
    touch_steps: int = 110
    final_scale: float = 0.05
    steps: StepSizes = StepSizes(translation=0.003, rotation=0.03, joints=0.05)
    weights: TermWeights = TermWeights(
        environment=4.0, object=4.0, self=16.0, contact=8.0, target=1.0, clearance_object=0.0005, contact_gap=0.0007
    )


def descend_to_contact(
    hand: Hand,
    fields: WarpStruct,
    surface: SurfacePoints,
    centre_of_mass: Float[np.ndarray, " 3"],
    *,
    config: NonPrehensileConfig,
    generator: np.random.Generator,
    upright: bool = False,
) -> tuple[Float[Tensor, "batch coordinates"], list[str]]:
    """Return (q, intents): configurations in the resting frame at the end of the descent, not yet verified.

    An intent is what its start was meant to be: push, press or hook. upright: the object stands on its end.
    """
    start = sample_pre_contact(hand, surface, centre_of_mass, count=config.batch, generator=generator, upright=upright)
    energy = HandEnergy(hand, fields, config.batch, config.weights)
    tips = hand.fingertip_indices
    touches = torch.as_tensor(start.touches, dtype=torch.float32)
    energy.target[:, tips] = torch.as_tensor(start.target, dtype=torch.float32)
    energy.target_weight[:, tips] = touches
    energy.contact_weight[:, tips] = touches
    descent = HandDescent(hand, config.batch, steps=config.steps)
    pose, total = start.pose, config.reach_steps + config.touch_steps
    for step in range(total):
        if step == config.reach_steps:
            energy.set_weights(replace(config.weights, target=0.0))
        energy(pose)
        pose = descent.step(pose, energy.gradient, scale=config.final_scale ** (step / total))
    return configuration_from_pose(pose), start.intents


@dataclass(frozen=True)
class PreContact:
    """Start poses, the target on the object's surface of each digit that is to touch [m], and the intended behaviour."""

    pose: HandPose
    target: Float[np.ndarray, "batch digit 3"]
    touches: Bool[np.ndarray, "batch digit"]
    intents: list[str]


def sample_pre_contact(
    hand: Hand,
    surface: SurfacePoints,
    centre_of_mass: Float[np.ndarray, " 3"],
    *,
    count: int,
    generator: np.random.Generator,
    upright: bool = False,
) -> PreContact:
    """Return start poses for one object at rest on a plane, resting frame; upright: on its end."""
    digits = len(hand.fingertips)
    angle = generator.uniform(0.0, 2 * np.pi, count)
    if upright:
        off = np.radians(generator.normal(0.0, UPRIGHT_SPREAD, count))
        angle = off + np.radians(90.0) * generator.integers(4, size=count)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    sizes = generator.choice(list(DIGIT_COUNTS), p=list(DIGIT_COUNTS.values()), size=count)
    shares = UPRIGHT_INTENTS if upright else INTENTS
    intents = generator.choice(list(shares), p=list(shares.values()), size=count).tolist()
    touches = np.zeros((count, digits), dtype=bool)
    target = np.zeros((count, digits, 3))
    outward = np.zeros((count, 3))
    for item in range(count):
        chosen = generator.permutation(digits)[: min(sizes[item], digits)]
        touches[item, chosen] = True
        places = (_upright_places if upright else _places)(
            surface, centre_of_mass, direction[item], len(chosen), generator, on_top=intents[item] == "press"
        )
        target[item, chosen] = surface.points[places]
        total = surface.normals[places].sum(axis=0)
        outward[item] = total / max(float(np.linalg.norm(total)), 1e-9)
    # A hooking hand comes from ahead of the object and reaches over it; the others come from anywhere.
    heading = generator.uniform(0.0, 2 * np.pi, count)
    against = angle + np.pi + np.radians(generator.normal(0.0, HOOK_SPREAD, count))
    heading = np.where([intent == "hook" for intent in intents], against, heading)
    pose = _poses(hand, target, touches, outward, heading, generator)
    return PreContact(_lifted(hand, pose, float(surface.points[:, 2].min())), target, touches, intents)


def _places(
    surface: SurfacePoints,
    centre_of_mass: Float[np.ndarray, " 3"],
    direction: Float[np.ndarray, " 2"],
    touching: int,
    generator: np.random.Generator,
    *,
    on_top: bool,
) -> list[int]:
    """Return the surface points that so many digits should touch."""
    normals, points = surface.normals, surface.points
    if on_top:
        usable = np.flatnonzero(normals[:, 2] > TOP_NORMAL)
    else:
        usable = np.flatnonzero(normals[:, :2] @ direction < -SIDE_NORMAL)
    if len(usable) == 0:
        usable = np.arange(len(points))
    lateral = np.asarray([-direction[1], direction[0]])
    first = points[generator.choice(usable)]
    along = (first[:2] - centre_of_mass[:2]) @ direction
    middle = generator.normal(0.0, LATERAL_SPREAD)
    turn = generator.uniform(-0.6, 0.6)
    places = []
    for shift in _row(touching, generator):
        wanted = (
            centre_of_mass[:2] + (along + shift * np.sin(turn)) * direction + (middle + shift * np.cos(turn)) * lateral
        )
        apart = np.linalg.norm(points[usable, :2] - wanted, axis=1) + 0.5 * np.abs(points[usable, 2] - first[2])
        places.append(int(usable[np.argmin(apart)]))
    return places


def _upright_places(
    surface: SurfacePoints,
    centre_of_mass: Float[np.ndarray, " 3"],
    direction: Float[np.ndarray, " 2"],
    touching: int,
    generator: np.random.Generator,
    *,
    on_top: bool,
) -> list[int]:
    """The same on an object that stands: digits in a row of any slope on its top, or on its trailing side, mostly high."""
    normals, points = surface.normals, surface.points
    ahead, lateral = np.array([*direction, 0.0]), np.array([-direction[1], direction[0], 0.0])
    low, high = points[:, 2].min(), points[:, 2].max()
    reached = points[:, 2] >= low + generator.uniform(0.0, HIGHEST_REACH) * (high - low)
    facing = normals[:, 2] > TOP_NORMAL if on_top else (normals @ ahead < -SIDE_NORMAL) & reached
    usable = np.flatnonzero(facing) if facing.any() else np.arange(len(points))
    first = points[generator.choice(usable)]
    first = first + (generator.normal(0.0, LATERAL_SPREAD) - (first - centre_of_mass) @ lateral) * lateral
    slope = generator.uniform(0.0, np.pi)
    row = np.cos(slope) * lateral + np.sin(slope) * (ahead if on_top else np.array([0.0, 0.0, 1.0]))
    wanted = first + _row(touching, generator)[:, None] * row
    return [int(usable[np.argmin(np.linalg.norm(points[usable] - each, axis=1))]) for each in wanted]


def _row(touching: int, generator: np.random.Generator) -> Float[np.ndarray, " touching"]:
    """Return where digits stand in a row about its middle [m]."""
    return (np.arange(touching) - (touching - 1) / 2) * DIGIT_SPREAD * generator.uniform(0.6, 1.3)


def _poses(
    hand: Hand,
    target: Float[np.ndarray, "batch digit 3"],
    touches: Bool[np.ndarray, "batch digit"],
    outward: Float[np.ndarray, "batch 3"],
    heading: Float[np.ndarray, " batch"],
    generator: np.random.Generator,
) -> HandPose:
    """Hands over their targets, headed as told [rad], fingers level to steeply down, palm mostly down, fingers flexed."""
    count = len(target)
    joint_angles = separated_joint_angles(hand, count, generator)
    pitch = np.radians(generator.uniform(*PITCH, count))
    roll = np.radians(generator.normal(0.0, ROLL_SPREAD, count))
    fingers = np.stack([np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), -np.sin(pitch)], axis=1)
    down = np.tile([0.0, 0.0, -1.0], (count, 1))
    palm = down - (down * fingers).sum(1, keepdims=True) * fingers
    palm /= np.maximum(np.linalg.norm(palm, axis=1, keepdims=True), 1e-9)
    side = np.cross(fingers, palm)
    palm = np.cos(roll)[:, None] * palm + np.sin(roll)[:, None] * side
    # Columns that carry the palm's own finger axis and palm normal onto the wanted directions.
    normal = hand.palm_normal / np.linalg.norm(hand.palm_normal)
    finger_axis = hand.finger_axis
    own = np.stack([np.cross(normal, finger_axis), normal, finger_axis], axis=1)
    wanted = np.stack([np.cross(palm, fingers), palm, fingers], axis=2)
    rotation = torch.as_tensor(wanted @ own.T, dtype=torch.float32)
    q = torch.zeros(count, 9 + hand.num_joints)
    q[:, 3:6], q[:, 6:9], q[:, 9:] = rotation[:, :, 0], rotation[:, :, 1], joint_angles
    tips = hand.keypoints(q).numpy()
    weight = touches[..., None] / touches.sum(axis=1)[:, None, None]
    standoff = generator.uniform(*STANDOFF, (count, 1))
    translation = (weight * (target - tips)).sum(axis=1) + standoff * outward
    return HandPose(torch.as_tensor(translation, dtype=torch.float32), rotation, joint_angles)


def _lifted(hand: Hand, pose: HandPose, support: float) -> HandPose:
    """The same hands, those that reach below the support's height [m] raised out of it."""
    points = hand.sparse_points
    transforms = hand.forward_kinematics(configuration_from_pose(pose)).numpy()[:, points.link, 2]
    height = np.einsum("bpi,pi->bp", transforms[..., :3], points.points) + transforms[..., 3]
    rise = np.maximum(support + ABOVE_SUPPORT - height.min(axis=1), 0.0)
    up = torch.as_tensor(rise, dtype=torch.float32)[:, None] * torch.tensor([0.0, 0.0, 1.0])
    return replace(pose, translation=pose.translation + up)


def separated_joint_angles(hand: Hand, count: int, generator: np.random.Generator) -> Float[Tensor, "count joint"]:
    """Return `random_joint_angles`, drawn again where links are deep in each other; after some draws the last one stays."""
    angles, again = random_joint_angles(hand, count, generator), np.arange(count)
    redraw = generator.spawn(1)[0]  # what is drawn later does not depend on how often this draws
    for _ in range(MOST_DRAWS - 1):
        overlap = self_penetration(hand, angles[again].numpy().astype(np.float64))
        again = again[overlap > INTERLOCKED]
        if not len(again):
            break
        angles[again] = random_joint_angles(hand, len(again), redraw)
    return angles


def random_joint_angles(hand: Hand, count: int, generator: np.random.Generator) -> Float[Tensor, "count joint"]:
    """Return loosely flexed joint angles within limits and couplings [rad]; slides are anywhere on their way [m]."""
    span = hand.upper - hand.lower
    # A joint that bends one way only is a flexion joint; one that swings both ways about zero is an abduction joint.
    flexes, flexes_backwards = hand.upper > -2 * hand.lower, hand.lower < -2 * hand.upper
    flexes |= hand.sliding
    share = generator.beta(1.6, 2.4, (count, hand.num_joints))
    flexed = np.where(flexes_backwards, hand.upper - span * share, hand.lower + span * share)
    swung = generator.normal(0.0, ABDUCTION_SPREAD, (count, hand.num_joints)) * span
    q = torch.zeros(count, 9 + hand.num_joints)
    q[:, 9:] = torch.as_tensor(np.where(flexes | flexes_backwards, flexed, swung), dtype=torch.float32)
    return hand.clamp(q)[:, 9:]
