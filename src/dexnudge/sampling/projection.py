"""Projection: from a configuration that nearly fits to one that penetrates nothing, touches, and can exert the force.

Paper III-C b: descend the loss with a collision check at each step until nothing penetrates. Here the loss also holds the
contacts, lowers the residual of the force balance, draws idle fingertips to where they can push, keeps the hand's path along
the motion free, and holds the user's terms. A hand stops once it is clean and touches, its forces balance, its path is free
and the user's terms have settled. Where that comes no nearer, clean and touching is enough. Penetration comes first: in the
second half of the steps the user's terms no longer pull, and a hand that is not clean at their end makes a few more in which
hardly anything else does.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from dexnudge.energies.descent import (
    HandDescent,
    HandPose,
    StepSizes,
    configuration_from_pose,
    pose_from_configuration,
)
from dexnudge.energies.hand_kernel import kinematics
from dexnudge.energies.kernel_structs import FAR
from dexnudge.energies.terms import TermWeights
from dexnudge.geometry.warp_runtime import WarpStruct, wp
from dexnudge.hands.hand import Hand
from dexnudge.sampling import projection_kernel
from dexnudge.sampling.guidance import active_contacts
from dexnudge.sampling.problem import FACING_MOTION, ON_TOP, TIP_RADIUS, PushableSurface, SamplingProblem

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
NOWHERE = 2.0  # no normal has such a z
LARGEST_GROUP, PACK_STEPS = 16, 4  # hands that one thread moves together; steps after which those that are done leave
SMALLEST_FALL, STALLED_STEPS = 0.01, 10  # relative fall in so many steps under which the user's terms have settled


@dataclass(frozen=True)
class ProjectionConfig:
    """Budget and tolerances of the projection."""

    max_steps: int = 80
    turning_factor: int = 5  # on all counts of steps where the object turns: fingertips go farther, and back
    turning_force: float = 0.5  # of the force's weight there: stronger, it pulls fingertips into the object and off it
    terms_factor: int = 2  # the same where the user has terms: they and the others settle one after the other
    steps: StepSizes = StepSizes(translation=0.002, rotation=0.015, joints=0.03)
    decay: tuple[float, float] = (0.7, 0.8)  # of the moments: see `HandDescent`
    final_scale: float = 0.1
    weights: TermWeights = PROJECTION_WEIGHTS
    contact_reach: float = 0.020  # [m] a fingertip this close at the start is held to the object
    contact_tolerance: float = 0.0010  # [m] of the gap to the object; success allows 2 mm
    depth_tolerance: float = 0.0001  # [m] that a guiding point may still be inside something
    force_tolerance: float = 0.05  # residual [weights of the object] that counts as balanced
    force_sweeps: int = 12  # of the balance solver per step, warm-started
    first_force_sweeps: int = 60  # before the first step, from a cold start
    idle_steps: int = 60  # first steps, in which idle fingertips are drawn to where they can push; hands wait for it
    guided_steps: int = 20  # first steps, which still count what the object cannot see as solid
    term_steps: int = 40  # first steps, in which the user's terms pull; the others still have to get a hand clear
    last_steps: int = 20  # more, for hands that did not come clean
    arrival: float = 0.012  # [m] from a helpful place at which a fingertip that goes there begins to touch
    patience: int = 30  # steps without progress after which a hand that is clean and touching waits for nothing else
    endurance: int = 60  # steps without progress after which any other hand is given up

    def factor(self, problem: SamplingProblem) -> int:
        """Return what all counts of steps are multiplied by."""
        turning = self.turning_factor if problem.helpful is not None else 1
        return max(turning, self.terms_factor if problem.terms else 1)

    def energy_weights(self, problem: SamplingProblem) -> TermWeights:
        """Return the weights of the energy that is descended."""
        turning = self.turning_force if problem.helpful is not None else 1.0
        return replace(self.weights, force=turning * self.weights.force)

    def letting_go(self) -> "ProjectionConfig":
        """Return the same for the last steps of hands that are not clean: what pulls them yields to what they penetrate."""
        weights = self.weights
        weights = replace(weights, contact=min(1.0, weights.contact), target=0.0, force=min(1e-5, weights.force))
        return replace(self, weights=weights, max_steps=self.last_steps, idle_steps=1, guided_steps=0, term_steps=0)


def project(
    hand: Hand, problem: SamplingProblem, q: Float[Tensor, "batch coordinates"], *, config: ProjectionConfig
) -> tuple[Float[Tensor, "batch coordinates"], dict[str, Shaped[Tensor, " batch"]]]:
    """Return projected configurations (frame C) and a report; a hand that never satisfies all is returned as it ended.

    The report has for each hand: projection_converged (it stopped by the rule above, not because steps ran out),
    projection_iterations (steps until it stopped), projection_moved_mm (mean way of the fingertips), contacts_before and
    contacts_after (fingertips that touch), force_residual_before and force_residual_after [weights of the object],
    depth_before_mm (deepest guiding point), and where the user has terms their energy terms_before and terms_after [m^2].
    """
    q = hand.equalise_tendon_joints(q)
    run = _Projection(hand, problem, q, config)
    run.descend()
    ended = run.ended()
    stuck = (~ended["projection_converged"]).nonzero()[:, 0]
    if len(stuck) > 0 and config.last_steps > 0:
        run_on = _Projection(hand, problem, ended["q"][stuck], config.letting_go())
        run_on.descend()
        last = run_on.ended()
        last["projection_iterations"] += ended["projection_iterations"][stuck]
        for name, values in last.items():
            ended[name][stuck] = values
    projected = ended.pop("q")
    before, after = hand.keypoints(torch.cat([q, projected])).chunk(2)
    report = {
        "projection_moved_mm": 1e3 * (after - before).norm(dim=2).mean(dim=1),
        "contacts_before": run.contacts_before,
        "force_residual_before": run.residual_before,
        "depth_before_mm": 1e3 * run.depth_before,
    }
    if problem.terms:
        report["terms_before"] = run.terms_before
    return projected, report | ended


class _Projection:
    """One projection of a batch of hands. Groups of hands descend on their own, each on one thread, to their last step."""

    def __init__(
        self, hand: Hand, problem: SamplingProblem, q: Float[Tensor, "batch coordinates"], config: ProjectionConfig
    ) -> None:
        batch, device = len(q), problem.device
        self.problem, self.config = problem, config
        self.energy = energy = problem.hand_energy(hand, batch, config.energy_weights(problem))
        self.tips, self.terms = hand.fingertip_indices, energy.terms
        self.force = energy.force if config.weights.force > 0 else None
        self.helpful = problem.helpful if self.force is not None else None
        self.factor = config.factor(problem)
        self.iterations, self.converged = (torch.zeros(batch, dtype=torch.int32, device=device) for _ in range(2))
        self.descent = HandDescent(hand, batch, steps=config.steps, decay=config.decay, tied=True, device=device)
        self._settling = Settling(batch, device=device)
        self._settled = torch.full((batch,), int(self.terms is None), dtype=torch.int32, device=device)
        self._slope = torch.zeros(batch, 6 + hand.num_joints if self.terms else 0, device=device)
        self._keypoints = torch.as_tensor(hand.fingertip_keypoints, dtype=torch.float32, device=device)
        self._one_at_a_time = Lock()
        pose = pose_from_configuration(q)
        energy.scene = problem.fields
        energy.contact_weight[:, self.tips] = 1.0
        energy(pose)
        distance = energy.contact_distance[:, self.tips]
        energy.contact_weight[:, self.tips] = active_contacts(distance, reach=config.contact_reach)
        self.depth_before, self.terms_before = energy.depth.amax(dim=(1, 2)), energy.term_energy.clone()
        self.contacts_before = self.touching().sum(dim=1)
        self.residual_before = torch.zeros(batch, device=device)
        self._packed = self._structs()

    @property
    def residual(self) -> Float[Tensor, " batch"]:
        """Distance to balance [weights of the object]; 0 without a balance."""
        return torch.zeros_like(self.residual_before) if self.force is None else self.force.residual

    def touching(self) -> Bool[Tensor, "batch digit"]:
        """Fingertips whose nearest guiding point is at the object's surface."""
        gap = self.energy.contact_distance[:, self.tips] - self.config.weights.contact_gap
        return gap.abs() < self.config.contact_tolerance

    def ended(self) -> dict[str, Shaped[Tensor, "batch *shape"]]:
        """Return where the hands ended, `q`, and what `project` reports of that."""
        found = {
            "q": configuration_from_pose(self.energy.pose),
            "projection_converged": self.converged > 0,
            "projection_iterations": self.iterations,
            "contacts_after": self.touching().sum(dim=1),
            "force_residual_after": self.residual,
        }
        return found | ({"terms_after": self.energy.term_energy} if self.terms is not None else {})

    def descend(self) -> None:
        """Move every hand until it is done or its steps are over."""
        batch, energy = len(self.iterations), self.energy
        wp.load_module(projection_kernel, device=energy.device)  # compiling is not safe from several threads
        threads = torch.get_num_threads() if energy.device == "cpu" else 1
        alone = self.terms is not None or self.helpful is not None  # what torch does is cheaper for many hands at once
        size = -(-batch // threads) if alone else LARGEST_GROUP
        groups = [torch.arange(low, min(low + size, batch), device=energy.device) for low in range(0, batch, size)]
        if threads == 1 or len(groups) == 1:
            for group in groups:
                self._descend(group)
        else:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(self._descend, groups))

    def _descend(self, rows: Int[Tensor, " row"]) -> None:
        energy, config = self.energy, self.config
        packed = rows.to(torch.int32)
        indices = wp.from_torch(packed)
        guided, plain = (
            energy.energy_launch(indices, each) for each in (self.problem.guiding_fields, self.problem.fields)
        )
        first, later = (
            energy.balance_launches(indices, sweeps=sweeps) if self.force is not None else []
            for sweeps in (config.first_force_sweeps, config.force_sweeps)
        )
        inputs = [energy.model, energy.state, self.descent.moments, *self._packed, indices]
        advance = wp.launch(
            projection_kernel.advance, dim=len(rows), inputs=inputs, device=energy.device, record_cmd=True
        )
        wp.launch(kinematics, dim=len(rows), inputs=[energy.model, energy.state, indices], device=energy.device)
        links = len(energy.hand.link_names)
        for step in range(self.factor * config.max_steps):
            (guided if step < self.factor * config.guided_steps else plain).launch()
            for launch in later if step else first:
                launch.launch()
            if step == 0:
                self.residual_before[rows] = self.residual[rows]
            if self.terms is not None or self.helpful is not None:
                self._torch_part(rows, step)
            advance.launch()
            if step % PACK_STEPS == 0:
                left = rows[energy.active[rows] > 0]
                if len(left) == 0:
                    return
                if len(left) < len(rows):
                    rows = left
                    packed[: len(rows)] = rows.to(packed)
                    for launch in (*first, *later, advance):
                        launch.set_dim(len(rows))
                    for launch in (guided, plain):
                        launch.set_dim((len(rows), links))
        plain.launch()

    def _torch_part(self, rows: Int[Tensor, " row"], step: int) -> None:
        """What no kernel does: the user's terms, and where one more fingertip would help a turn."""
        energy, config, term_steps = self.energy, self.config, self.factor * self.config.term_steps
        with self._one_at_a_time:
            if self.terms is not None and step < term_steps:
                pose = HandPose(energy.root_translation[rows], energy.root_rotation[rows], energy.joint_angles[rows])
                energy.term_energy[rows], self._slope[rows] = self.terms(pose)
                self._settled[rows] = self._settling(energy.term_energy[rows], rows).int()
            elif self.terms is not None and step == term_steps:
                self._slope[rows], self._settled[rows] = 0.0, 1
                self.descent.forget(rows)  # the terms' moments would slow the rest
            if self.helpful is not None and self.force is not None:
                links = rows[:, None], torch.tensor(self.tips, device=energy.device)
                own = torch.einsum("bdij,dj->bdi", energy.link_rotation[links], self._keypoints)
                keypoints = own + energy.link_translation[links]
                idle, places = self.helpful(self.force.wrench[rows], self.force.loaded[rows], keypoints)
                idle &= (self.residual[rows] >= config.force_tolerance)[:, None] & (
                    step < self.factor * config.idle_steps
                )
                arrived = (keypoints - places).norm(dim=2) < config.arrival
                energy.contact_weight[links] = torch.where(idle, arrived.float(), energy.contact_weight[links])
                energy.target_weight[links] = idle.float()
                energy.target[links] = torch.where(idle[..., None], places, energy.target[links])

    def _structs(self) -> tuple[WarpStruct, WarpStruct, WarpStruct]:
        """What `advance` reads beside the hands."""
        config, device = self.config, self.energy.device
        rules = projection_kernel.Rules()
        rules.contact_gap, rules.contact_tolerance = config.weights.contact_gap, config.contact_tolerance
        rules.depth_tolerance, rules.force_tolerance = config.depth_tolerance, config.force_tolerance
        rules.idle_steps, rules.guided_steps = self.factor * config.idle_steps, self.factor * config.guided_steps
        rules.patience, rules.endurance = self.factor * config.patience, self.factor * config.endurance
        rules.max_steps, rules.final_scale = self.factor * config.max_steps, config.final_scale
        progress = projection_kernel.Progress()
        progress.tips = wp.array(self.tips, dtype=wp.int32, device=device)
        progress.square = wp.from_torch(self.residual_before if self.force is None else self.force.square)
        progress.settled, progress.slope = wp.from_torch(self._settled), wp.from_torch(self._slope)
        progress.iterations, progress.converged = wp.from_torch(self.iterations), wp.from_torch(self.converged)
        progress.fits, progress.since = (wp.zeros(len(self.converged), dtype=int, device=device) for _ in range(2))
        progress.least = wp.full(len(self.converged), FAR, dtype=float, device=device)
        return (
            rules,
            packed_surface(self.problem.pushable, drawn=self.force is not None and self.helpful is None, device=device),
            progress,
        )


class Settling:
    """Whether the energy of the user's terms is negligible, or has stopped falling; each hand on its own."""

    def __init__(self, batch: int, *, device: torch.device | str = "cpu") -> None:
        self._least = torch.full((batch,), torch.inf, device=device)
        self._stalled = torch.zeros(batch, dtype=torch.long, device=device)

    def __call__(self, energy: Float[Tensor, " row"], rows: Int[Tensor, " row"]) -> Bool[Tensor, " row"]:
        """Return which of the hands `rows` have settled, `energy` [m^2] being that of their next step."""
        falls = energy < (1.0 - SMALLEST_FALL) * self._least[rows]
        self._least[rows] = torch.where(falls, energy, self._least[rows])
        self._stalled[rows] = torch.where(falls, 0, self._stalled[rows] + 1)
        return (energy <= NEGLIGIBLE_TERMS) | (self._stalled[rows] >= STALLED_STEPS)


def packed_surface(surface: PushableSurface, *, drawn: bool, device: str) -> WarpStruct:
    """Return where idle fingertips are drawn to, nowhere unless `drawn`, as the kernel reads it."""
    packed = projection_kernel.Pushable()
    for name in ("linear", "angular"):
        vectors = np.stack([getattr(twist, name) for twist in surface.twists])
        setattr(packed, name, wp.array(vectors.astype(np.float32), dtype=wp.vec3, device=device))
    packed.places = wp.array(surface.places.numpy(force=True)[: None if drawn else 0], dtype=wp.vec3, device=device)
    packed.facing, packed.on_top = FACING_MOTION, NOWHERE if surface.press_moves else ON_TOP
    packed.tip_radius = TIP_RADIUS
    return packed
