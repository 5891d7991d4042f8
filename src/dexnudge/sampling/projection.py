"""Projection: from a configuration that nearly fits to one that penetrates nothing, touches, and can exert the force.

Paper III-C b: descend the loss with a collision check at each step until nothing penetrates. Here the loss also holds the
contacts, lowers the residual of the force balance, draws idle fingertips to where they can push, keeps the hand's path along
the motion free, and holds the user's terms. A hand stops once it is clean and touches, its forces balance, its path is free
and the user's terms have settled. When the patience is over, clean and touching is enough. Penetration comes first: in the
second half of the steps the user's terms no longer pull.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor

from dexnudge.energies.descent import (
    HandDescent,
    StepSizes,
    configuration_from_pose,
    pose_from_configuration,
)
from dexnudge.energies.evaluator import HandEnergy
from dexnudge.energies.weights import TermWeights
from dexnudge.hands.hand import Hand
from dexnudge.sampling.guidance.rule import active_contacts
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


NEGLIGIBLE_TERMS = 1.0e-6  # [m^2] energy of the user's terms that is not worth a step: one point 1 mm off
SMALLEST_FALL, STALLED_STEPS = 0.01, 10  # relative fall in so many steps under which the user's terms have settled


@dataclass(frozen=True)
class ProjectionConfig:
    """Budget and tolerances of the projection."""

    max_steps: int = 160
    turning_steps: int = 240  # the same where the object turns: fingertips go farther, and have to come clear again
    steps: StepSizes = StepSizes(translation=0.002, rotation=0.015, joints=0.03)
    final_scale: float = 0.1
    weights: TermWeights = PROJECTION_WEIGHTS
    contact_reach: float = 0.020  # [m] a fingertip this close at the start is held to the object
    contact_tolerance: float = 0.0010  # [m] of the gap to the object; success allows 2 mm
    depth_tolerance: float = 0.0001  # [m] that a guiding point may still be inside something
    force_tolerance: float = 0.05  # residual [weights of the object] that counts as balanced
    force_sweeps: int = 12  # of the balance solver per step, warm-started
    first_force_sweeps: int = 200  # before the first step, from a cold start
    idle_steps: int = 120  # first steps, in which fingertips that cannot push are drawn to where they can
    guided_steps: int = 40  # first steps, which still count what the object cannot see as solid
    term_steps: int = (
        80  # first steps, in which the user's terms pull; the others must still get a hand out of what it penetrates
    )
    arrival: float = 0.012  # [m] from a helpful place at which a fingertip that goes there begins to touch
    patience: int = 120  # steps after which a hand that is clean and touching waits for nothing else


def project(
    hand: Hand, problem: SamplingProblem, q: Float[Tensor, "batch coordinates"], *, config: ProjectionConfig
) -> tuple[Float[Tensor, "batch coordinates"], dict[str, Shaped[Tensor, " batch"]]]:
    """Return projected configurations (frame C) and a report; a hand that never satisfies all is returned as it ended.

    The report has for each hand: projection_converged (it stopped by the rule above, not because steps ran out),
    projection_iterations (steps until it stopped), projection_moved_mm (mean way of the fingertips), contacts_before and
    contacts_after (fingertips that touch), force_residual_before and force_residual_after [weights of the object],
    depth_before_mm (deepest guiding point), and where the user has terms their energy terms_before and terms_after [m^2].
    """
    batch = len(q)
    q = hand.equalise_tendon_joints(q)
    tips = hand.fingertip_indices
    energy = problem.hand_energy(hand, batch, config.weights)
    terms, settling = energy.terms, Settling(batch, device=q.device)
    force = energy.force if config.weights.force > 0 else None
    descent = HandDescent(hand, batch, steps=config.steps, tied=True, device=problem.device)
    pose = pose_from_configuration(q)
    start_keypoints = hand.keypoints(q)

    energy.scene = problem.fields
    energy.contact_weight[:, tips] = 1.0
    energy(pose)
    energy.contact_weight[:, tips] = active_contacts(energy.contact_distance[:, tips], reach=config.contact_reach)
    depth_before, terms_before = energy.depth.amax(dim=(1, 2)), energy.term_energy.clone()
    contacts_before = touching(energy, tips, config).sum(dim=1)
    moving = torch.ones(batch, dtype=torch.bool, device=q.device)
    iterations = torch.zeros(batch, dtype=torch.long, device=q.device)
    residual = residual_before = torch.zeros(batch, device=q.device)
    balanced = settled = torch.ones(batch, dtype=torch.bool, device=q.device)
    max_steps = config.max_steps if problem.helpful is None else config.turning_steps
    for step in range(max_steps):
        energy.scene = problem.guiding_fields if step < config.guided_steps else problem.fields
        if terms is not None and step == config.term_steps:
            energy.terms, settled = None, torch.ones_like(settled)
            descent = HandDescent(
                hand, batch, steps=config.steps, tied=True, device=problem.device
            )  # the terms' moments would slow the rest
        if step == config.guided_steps:
            energy.active.fill_(1)  # the fields change, so a hand that has stopped may have to go on
        energy(pose)
        contact = touching(energy, tips, config)
        if force is not None:
            energy.balance_forces(sweeps=config.force_sweeps if step else config.first_force_sweeps)
            residual = force.residual
            balanced = residual < config.force_tolerance
            if step == 0:
                residual_before = residual.clone()
            near, points = energy.contact_weight[:, tips] > 0, energy.contact_point[:, tips]
            normals = energy.contact_normal[:, tips]
            asked = ~balanced[:, None] & (step < config.idle_steps)
            if problem.helpful is not None:
                keypoints = hand.keypoints(configuration_from_pose(pose))
                idle, places = problem.helpful(force, keypoints)
                idle &= asked
                arrived = (keypoints - places).norm(dim=2) < config.arrival
                energy.contact_weight[:, tips] = torch.where(idle, arrived.float(), energy.contact_weight[:, tips])
            else:
                idle = problem.pushable.idle(points, normals) & near & asked
                places = problem.pushable.nearest(points, normals) if idle.any() else points
            energy.target_weight[:, tips] = idle.float()
            if idle.any():
                energy.target[:, tips] = places
        if energy.terms is not None:
            settled = settling(energy.term_energy)
        clean = energy.depth.amax(dim=(1, 2)) <= config.depth_tolerance
        held = (contact | (energy.contact_weight[:, tips] == 0)).all(dim=1) & contact.any(dim=1)
        path_free = energy.swept_depth.amax(dim=1) <= config.depth_tolerance
        moving = ~(clean & held & ((balanced & path_free & settled) | (step >= config.patience)))
        if not moving.any():
            break
        energy.active.copy_(moving)
        iterations += moving
        scale = config.final_scale ** (step / max_steps) * moving[:, None].float()
        pose = descent.step(pose, energy.gradient, scale=scale)
    energy.active.fill_(1)
    energy.terms = terms
    energy(pose)
    projected = configuration_from_pose(pose)
    report = {
        "projection_converged": ~moving,
        "projection_iterations": iterations,
        "projection_moved_mm": 1e3 * (hand.keypoints(projected) - start_keypoints).norm(dim=2).mean(dim=1),
        "contacts_before": contacts_before,
        "contacts_after": touching(energy, tips, config).sum(dim=1),
        "force_residual_before": residual_before,
        "force_residual_after": residual,
        "depth_before_mm": 1e3 * depth_before,
    }
    if terms is not None:
        report |= {"terms_before": terms_before, "terms_after": energy.term_energy}
    return projected, report


class Settling:
    """Whether the energy of the user's terms is negligible, or has stopped falling; each hand on its own."""

    def __init__(self, batch: int, *, device: torch.device | str = "cpu") -> None:
        self._least = torch.full((batch,), torch.inf, device=device)
        self._stalled = torch.zeros(batch, dtype=torch.long, device=device)

    def __call__(self, energy: Float[Tensor, " batch"]) -> Bool[Tensor, " batch"]:
        """Return which hands have settled, `energy` [m^2] being that of the next step."""
        falls = energy < (1.0 - SMALLEST_FALL) * self._least
        self._least = torch.where(falls, energy, self._least)
        self._stalled = torch.where(falls, 0, self._stalled + 1)
        return (energy <= NEGLIGIBLE_TERMS) | (self._stalled >= STALLED_STEPS)


def touching(energy: HandEnergy, tips: list[int], config: ProjectionConfig) -> Bool[Tensor, "batch digit"]:
    """Fingertips whose nearest guiding point is at the object's surface."""
    return (energy.contact_distance[:, tips] - config.weights.contact_gap).abs() < config.contact_tolerance
