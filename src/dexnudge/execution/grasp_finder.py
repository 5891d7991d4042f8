"""Grasps of an object where it lies now: drawn by the same model, clean by exact distance, holding in the hold test.

The surroundings come in as for pushes: the model knows the object alone, guidance and projection keep the hand out of the
rest. The forces are asked to hold the object's weight tilted by 60 degrees: at that angle an object would slide off fingers
that only carry it, so digits have to oppose each other. The hold test, as in the dataset, and a rehearsal of the lift decide
what holds.
"""

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from dexnudge.energies.force_residual import SlidingBalance
from dexnudge.geometry.transforms import transform_configurations
from dexnudge.hands.batch import HandBatch
from dexnudge.hands.hand import Hand
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.sampling.denoise import DenoisingConfig
from dexnudge.sampling.guidance.clean import CleanDescent
from dexnudge.sampling.methods import GUIDING_WEIGHTS, METHODS
from dexnudge.sampling.problem import SamplingProblem, prepare
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hold import FARTHEST, MOST_TURNED, HoldTest, LiftRehearsal
from dexnudge.verification.criteria import PENETRATION_LIMIT
from dexnudge.verification.measurements import Measurements

TILT = np.radians(60.0)  # of the weight that the projection balances: beyond the angle of friction of any fingertip
NARROWED = 0.6  # of the hand's friction that it may use for that: forces stay away from the edges of their cones
PARTICLES = 16  # coarse hands of each draw: most grasps of the object alone meet its surroundings
GRASPS = replace(
    METHODS["grasp_projection"],
    summary="grasps in their surroundings, the best of 16 coarse hands denoised again under guidance, then projected",
    make_rule=CleanDescent,
    denoising=DenoisingConfig(particles=PARTICLES, weights=GUIDING_WEIGHTS),
)


@dataclass(frozen=True)
class Grasp:
    """A grasp that holds.

    q: in the object's frame. contacts: the same frame. drift: how far the object moved in the hold test or in the
    rehearsal of the lift, whichever is more, as a share of what it may move; the least is the best.
    """

    q: Float[np.ndarray, " coordinates"]
    contacts: HandContacts
    drift: float


class GraspFinder:
    """Finds grasps of the scene's object by one hand, wherever the object lies; `rehearsal` is of lifts of the same."""

    def __init__(self, hand: Hand, sampler: Sampler, scene: Scene, rehearsal: LiftRehearsal) -> None:
        self._hand, self._sampler, self._rehearsal = hand, sampler, rehearsal
        self._hold = HoldTest(hand, scene.object_mesh)

    def find(self, scene: Scene, *, num: int, seed: int) -> tuple[list[Grasp], Counter[str]]:
        """Return the grasps among `num` draws in this scene that hold, best first; the other draws by the reason why not."""
        problem = prepare(scene, device=self._sampler.device)
        problem = replace(problem, balances=(holding_balance(problem),))
        drawn = self._sampler.draw(problem, num=num, seed=seed, method=GRASPS).q.astype(np.float64)
        q = transform_configurations(np.linalg.inv(scene.T_world_object), drawn)
        reasons, contacts = self._touch(scene, q)
        grasps = []
        for row, reason in enumerate(reasons):
            if reason:
                continue
            held = self._hold(q[row : row + 1], [contacts[row]])[0]
            if not held.held:
                reasons[row] = held.reason
                continue
            pose = scene.T_world_object
            rehearsed = self._rehearsal(drawn[row], contacts[row].moved(pose), pose)
            if rehearsed > 1.0:
                reasons[row] = "drops when rehearsed"
                continue
            drift = max(held.translation / FARTHEST, held.rotation / MOST_TURNED, rehearsed)
            grasps.append(Grasp(q[row], contacts[row], drift))
        return sorted(grasps, key=lambda grasp: grasp.drift), Counter(reason for reason in reasons if reason)

    def still_clean(self, scene: Scene, grasps: list[Grasp]) -> list[Grasp]:
        """Return those that are clean in this scene too, in which the object may lie elsewhere."""
        if not grasps:
            return []
        reasons, _ = self._touch(scene, np.array([grasp.q for grasp in grasps]))
        return [grasp for grasp, reason in zip(grasps, reasons, strict=True) if not reason]

    def _touch(self, scene: Scene, q: Float[np.ndarray, "n coordinates"]) -> tuple[list[str], list[HandContacts]]:
        """Return why each q (object frame) is not clean, "" if it is, and its contacts with the object."""
        environment = scene.environment_mesh.copy()
        environment.apply_transform(np.linalg.inv(scene.T_world_object))
        own = replace(scene, environment_mesh=environment, T_world_object=np.eye(4))
        measured = Measurements(HandBatch(self._hand, torch.as_tensor(q)), own)
        found, reasons = measured.penetrations, []
        for row, contact in enumerate(measured.contacts):
            depths = {"object": found.object, "environment": found.environment, "self": found.self_collision}
            deep = [f"penetration {name}" for name, depth in depths.items() if depth[row] > PENETRATION_LIMIT]
            reasons.append(deep[0] if deep else ("" if len(contact.points) else "no contact"))
        return reasons, measured.contacts


def holding_balance(problem: SamplingProblem) -> SlidingBalance:
    """Return the balance of the object held in the air, its weight tilted by 60 degrees against the motion; frame C."""
    task = sliding_task(problem.scene)
    T_canonical_world = np.linalg.inv(problem.T_world_canonical)
    centre = T_canonical_world[:3, :3] @ task.centre + T_canonical_world[:3, 3]
    weight = np.array([np.sin(TILT), 0.0, -np.cos(TILT)])  # x of frame C is the motion
    return SlidingBalance(
        centre_of_mass=torch.as_tensor(centre, dtype=torch.float32),
        half_length=task.half_length,
        support_wrenches=torch.zeros(1, 6),
        gravity=torch.as_tensor(weight, dtype=torch.float32),
        friction_hand=NARROWED * task.friction_hand,
        max_normal=task.max_normal_force / task.weight,
    )
