"""The second act: grasp the object where it lies, lift it and hold it.

Grasps are drawn by the same model, clean by exact distance, and hold in the hold test. The surroundings come in as for
pushes: the model knows the object alone, guidance and projection keep the hand out of the rest. The forces are asked to hold
the object's weight tilted by 60 degrees: at that angle an object would slide off fingers that only carry it, so digits have
to oppose each other. The hold test, as in the dataset, and a rehearsal of the lift decide what holds.
"""

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from dexnudge.energies.force_residual import SlidingBalance
from dexnudge.execution.scene_rollout import SceneRollout
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_points import surface_points
from dexnudge.geometry.transforms import transform_configurations
from dexnudge.hands.batch import HandBatch
from dexnudge.hands.hand import Hand
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.approach import Approach, ApproachPlanner
from dexnudge.planning.hand_clearance import HandClearance
from dexnudge.planning.outcomes import Outcome
from dexnudge.sampling.denoise import DenoisingConfig
from dexnudge.sampling.guidance_rules import CleanDescent
from dexnudge.sampling.methods import GUIDING_WEIGHTS, METHODS
from dexnudge.sampling.problem import SamplingProblem, prepare
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hand_path import along_line, along_way, waiting
from dexnudge.simulation.hold import FARTHEST, MOST_TURNED, HoldTest, LiftRehearsal, squeeze
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


OUTWARD = tuple(np.arange(0.0, 0.401, 0.04))  # [m] along the motion before the lift, the least first
RAISE = 0.004  # [m] off the support before it moves outward: the springs of the base give way by 1.5 mm
STEP = 0.005  # [m] between the places that are looked at
SPACING = 0.005  # [m] between the points of the object
ROOM = 0.001  # [m] that hand and object keep on the way, or what they have at its start
ALLOWANCE = 0.0005  # [m] less than at the start: rounding and what contacts yield


class LiftWay:
    """Finds ways up for one hand that holds the object of one scene."""

    def __init__(self, hand: Hand, scene: Scene, *, height: float) -> None:
        self._scene, self._height = scene, height
        self._hand = HandClearance(hand, scene)
        self._environment = ExactDistance(scene.environment_mesh)
        self._points = surface_points(scene.object_in_world(), spacing=SPACING).points

    def __call__(self, q: Float[np.ndarray, " coordinates"]) -> list[Float[np.ndarray, " 3"]] | None:
        """Return translations [m, world] one after another, `height` up in all, outward as little as need be, or None."""
        up = np.array([0.0, 0.0, 1.0])
        for outward in OUTWARD:
            ways = [self._height * up]
            if outward > 0:
                ways = [RAISE * up, outward * self._scene.motion, (self._height - RAISE) * up]
            if self._free(q, ways):
                return ways
        return None

    def _free(self, q: np.ndarray, ways: list[np.ndarray]) -> bool:
        shifts, start = [np.zeros(3)], np.zeros(3)
        for way in ways:
            count = int(np.ceil(np.linalg.norm(way) / STEP))
            shifts += [start + way * step / count for step in range(1, count + 1)]
            start = start + way
        hand = self._hand.shifted(q, np.array(shifts)).distance[:, 0]
        if (hand < min(ROOM, hand[0] - ALLOWANCE)).any():
            return False
        distances = (float(self._environment(self._points + shift).distance.min()) for shift in shifts)
        least = min(ROOM, next(distances) - ALLOWANCE)
        return all(distance >= least for distance in distances)


LIFT_PHASES = ("reach", "close", "lift", "hold", "lower")
LIFT = 0.10  # [m]
LIFT_SPEED = 0.10  # [m/s] in the middle of the lift
HOLD_TIME = 2.0  # [s]
SQUEEZE_SHARE = 0.75  # of the hand's friction that the squeeze's forces use: 0.6 of 0.8, as in the hold test
MOST_PLANNED = 6  # grasps that are planned for until one has a way
GRASP_BATCHES = 3  # of draws until one holds


@dataclass(frozen=True)
class ChosenGrasp:
    """A grasp with the way there and the translations [m, world] by which it is lifted."""

    grasp: Grasp
    approach: Approach
    ways: list[Float[np.ndarray, " 3"]]


@dataclass(frozen=True)
class NoGrasp:
    """No grasp could be tried; phase: "grasp search" or "approach". detail: what `outcome` leaves open, for people."""

    phase: str
    outcome: Outcome
    detail: str


class GraspAndLift:
    """Grasps and lifts the object of a stage; no grasp is tried twice, nor planned for where no way was found.

    Attributes:
        found: grasps that are known to hold and have not been tried.
        drawn: draws so far.
    """

    def __init__(self, stage: SceneRollout, finder: GraspFinder, *, draws: int, seed: int) -> None:
        self._stage, self._finder, self._draws, self._seed = stage, finder, draws, seed
        self.found: list[Grasp] = []
        self.drawn = 0
        self._blocked = 0

    def choose(self, scene: Scene) -> ChosenGrasp | NoGrasp:
        """Return the best grasp that the hand can reach from where it is, and lift; draw some where none is known."""
        self.found = self._finder.still_clean(scene, self.found)
        rejected: Counter[str] = Counter()
        for _ in range(GRASP_BATCHES):
            if self.found:
                break
            self.found, rejected = self._finder.find(scene, num=self._draws, seed=self._seed + self.drawn)
            self.drawn += self._draws
        if not self.found:
            text = ", ".join(f"{reason} {count}" for reason, count in rejected.most_common())
            detail = f"in {self.drawn} draws; of the last {self._draws}: {text}"
            return NoGrasp("grasp search", Outcome.NO_GRASP, detail)
        planner, up = ApproachPlanner(self._stage.hand, scene), LiftWay(self._stage.hand, scene, height=LIFT)
        reasons = []
        for grasp in self.found[:MOST_PLANNED]:
            q = np.asarray(transform_configurations(scene.T_world_object, grasp.q[None])[0])
            ways = up(q)
            if ways is None:
                reasons.append("no free way up or out")
                continue
            approach = planner.plan(q, start=self._stage.q, seed=self._blocked)
            if isinstance(approach, Approach):
                return ChosenGrasp(grasp, approach, ways)
            reasons.append(f"{approach.stage}: {approach.reason}")
        self.found, self._blocked = self.found[MOST_PLANNED:], self._blocked + 1
        return NoGrasp("approach", Outcome.APPROACH_BLOCKED, f"for {len(reasons)} grasps; the best: {reasons[0]}")

    def lift(self, scene: Scene, chosen: ChosenGrasp) -> None:
        """Go there, close, lift, hold."""
        self.found = [other for other in self.found if other is not chosen.grasp]
        rollout = self._stage.go_to_pre_contact(chosen.approach, from_outside=True)
        times, q = chosen.approach.last_stretch
        rollout.follow(along_way(times, q), "reach")
        contacts = chosen.grasp.contacts.moved(scene.T_world_object)
        half_length = sliding_task(scene).half_length
        with rollout.elsewhere():
            model = self._stage.model_at(scene)
            model.place(q[-1])
            friction = SQUEEZE_SHARE * scene.friction_hand
            _, torque = squeeze(model, contacts, half_length=half_length, friction=friction)
        rollout.close(torque, "close")
        for way in chosen.ways:
            rollout.follow(along_line(rollout.commanded, way, speed=LIFT_SPEED), "lift")
        rollout.follow(waiting(rollout.commanded, seconds=HOLD_TIME), "hold")

    def put_back(self, chosen: ChosenGrasp) -> None:
        """Lower the object, let go, and back off."""
        rollout = self._stage.rollout
        for way in reversed(chosen.ways):
            rollout.follow(along_line(rollout.commanded, -way, speed=LIFT_SPEED), "lower")
        rollout.let_go()
        self._stage.back_off(chosen.approach)
