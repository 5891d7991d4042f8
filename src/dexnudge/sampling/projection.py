"""Projection: from a configuration that nearly fits to one that penetrates nothing, touches, and can exert the force.

Paper III-C b: descend the loss with a collision check at each step until nothing penetrates. Here the loss also holds the
contacts, lowers the residual of the force balance, draws idle fingertips to where they can work and keeps the hand's way
along the motion free. A hand stops moving when it is clean and touches, its forces balance and its way is free; or, when its
patience is over, without the last two.
"""

from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dexnudge.energies.descent import (
    HandDescent,
    StepSizes,
    configuration_from_pose,
    pose_from_configuration,
)
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.force_residual import ForceResidual
from dexnudge.energies.weights import TermWeights
from dexnudge.hands.hand import Hand
from dexnudge.sampling.guidance.active_contacts import active_contacts
from dexnudge.sampling.problem import SamplingProblem

PROJECTION_WEIGHTS = TermWeights(
    contact=6.0,
    target=1.0,
    sweep=1.0,
    base=1.0,
    force=0.001,
    clearance_object=0.0005,
    clearance_environment=0.0015,
    clearance_base=0.010,
    contact_gap=0.0007,
)


@dataclass(frozen=True)
class ProjectionConfig:
    """Budget and tolerances of the projection."""

    max_steps: int = 160
    steps: StepSizes = StepSizes(translation=0.002, rotation=0.015, joints=0.03)
    final_scale: float = 0.1
    weights: TermWeights = PROJECTION_WEIGHTS
    contact_reach: float = 0.020  # [m] a fingertip this close at the start is held to the object
    contact_tolerance: float = 0.0010  # [m] of the gap to the object; success allows 2 mm
    depth_tolerance: float = 0.0001  # [m] that a guiding point may still be inside something
    force_tolerance: float = 0.05  # residual [weights of the object] that counts as balanced
    force_sweeps: int = 12  # of the balance solver per step, warm-started
    first_force_sweeps: int = 200  # before the first step, from a cold start
    idle_steps: int = 120  # first steps, in which fingertips that cannot work are drawn to where they can
    guided_steps: int = 40  # first steps, which still count the environment's shadow as solid
    patience: int = 120  # steps after which a hand that is clean and touching stops waiting for its forces and its way


@dataclass
class ProjectionReport:
    """What the projection did, per configuration.

    Attributes:
        iterations: steps until the hand was left alone. converged: clean, touching, balanced and with a free
            way by its own measure, or out of patience for the last two.
        moved: mean distance [m] that the fingertips travelled. contacts_before, contacts_after: fingertips that touch.
        residual_before, residual_after: of the force balance [weights of the object].
    """

    iterations: Int[Tensor, " batch"]
    converged: Bool[Tensor, " batch"]
    moved: Float[Tensor, " batch"]
    contacts_before: Int[Tensor, " batch"]
    contacts_after: Int[Tensor, " batch"]
    residual_before: Float[Tensor, " batch"]
    residual_after: Float[Tensor, " batch"]
    depth_before: Float[Tensor, " batch"] = field(default_factory=lambda: torch.zeros(0))


def project(
    hand: Hand, problem: SamplingProblem, q: Float[Tensor, "batch coordinates"], *, config: ProjectionConfig
) -> tuple[Float[Tensor, "batch coordinates"], ProjectionReport]:
    """Projected configurations (frame C) and the report; a hand that never satisfies all is returned as it ended."""
    batch = len(q)
    q = hand.tie(q)
    tips = hand.fingertip_indices
    energy = HandEnergy(hand, problem.fields, batch, config.weights)
    balance = problem.balance if config.weights.force > 0 else None
    force = ForceResidual(balance, batch, len(tips)) if balance is not None else None
    descent = HandDescent(hand, batch, steps=config.steps, tied=True)
    pose = pose_from_configuration(q)
    start_keypoints = hand.keypoints(q)

    energy.contact_weight[:, tips] = 1.0
    energy(pose)
    energy.contact_weight[:, tips] = active_contacts(energy.contact_distance[:, tips], reach=config.contact_reach)
    depth_before = energy.depth.amax(dim=(1, 2)).clone()
    contacts_before = touching(energy, tips, config).sum(dim=1)
    moving = torch.ones(batch, dtype=torch.bool)
    iterations = torch.zeros(batch, dtype=torch.long)
    residual = residual_before = torch.zeros(batch)
    balanced = torch.ones(batch, dtype=torch.bool)
    for step in range(config.max_steps):
        energy.scene = problem.guiding_fields if step < config.guided_steps else problem.fields
        if step == config.guided_steps:
            energy.active.fill_(1)  # other fields: a hand that stands still must be looked at once more
            if force is not None:
                force.active.fill_(1)
        energy(pose)
        contact = touching(energy, tips, config)
        if force is not None:
            near = (energy.contact_weight[:, tips] > 0).float()
            force(
                energy.contact_point[:, tips],
                energy.contact_normal[:, tips],
                near,
                sweeps=config.force_sweeps if step else config.first_force_sweeps,
            )
            residual = force.residual
            balanced = residual < config.force_tolerance
            if step == 0:
                residual_before = residual.clone()
            energy.extra_force[:, tips] = config.weights.force * force.gradient
            idle = problem.working.idle(energy.contact_normal[:, tips]) & (near > 0) & ~balanced[:, None]
            idle &= step < config.idle_steps
            energy.target_weight[:, tips] = idle.float()
            if idle.any():
                energy.target[:, tips] = problem.working.nearest(
                    energy.contact_point[:, tips], energy.contact_normal[:, tips]
                )
        clean = energy.depth.amax(dim=(1, 2)) <= config.depth_tolerance
        held = (contact | (energy.contact_weight[:, tips] == 0)).all(dim=1) & contact.any(dim=1)
        way_free = energy.swept_depth.amax(dim=1) <= config.depth_tolerance
        moving = ~(clean & held & ((balanced & way_free) | (step >= config.patience)))
        if not moving.any():
            break
        energy.active.copy_(moving)
        if force is not None:
            force.active.copy_(moving)
        iterations += moving
        scale = config.final_scale ** (step / config.max_steps) * moving[:, None].float()
        pose = descent.step(pose, energy.gradient, scale=scale)
    energy.active.fill_(1)
    energy(pose)
    projected = configuration_from_pose(pose)
    report = ProjectionReport(
        iterations=iterations,
        converged=~moving,
        moved=(hand.keypoints(projected) - start_keypoints).norm(dim=2).mean(dim=1),
        contacts_before=contacts_before,
        contacts_after=touching(energy, tips, config).sum(dim=1),
        residual_before=residual_before,
        residual_after=residual,
        depth_before=depth_before,
    )
    return projected, report


def touching(energy: HandEnergy, tips: list[int], config: ProjectionConfig) -> Bool[Tensor, "batch digit"]:
    """Fingertips whose nearest guiding point is at the object's surface."""
    return (energy.contact_distance[:, tips] - config.weights.contact_gap).abs() < config.contact_tolerance
