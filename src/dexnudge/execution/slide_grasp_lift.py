"""Slide, grasp, lift: an object that cannot be grasped where it lies is pushed to where it can, grasped, and lifted.

One continuous simulation. When something fails, the next try goes on from where hand and object are then, as a robot
would: with the next configuration of the folder where the object still has to slide, else with the next grasp.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from dexnudge.evaluation.success import contacts_of, judge
from dexnudge.execution.grasping import Grasp, GraspFinder
from dexnudge.execution.lift_way import LiftWay
from dexnudge.execution.retreat import retreat
from dexnudge.geometry.frames import transform_configurations
from dexnudge.hands.hand import Hand
from dexnudge.mechanics.contacts import HandContacts, support_contacts
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.approach import Approach, ApproachPlanner
from dexnudge.planning.object_motion import DEFAULT_LIMITS, GraspableLimits, NoObjectMotion, plan_object_motion
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.drive import SPEED, push_drive
from dexnudge.simulation.episode import Episode, Trace
from dexnudge.simulation.hand_path import along_line, along_way, waiting
from dexnudge.simulation.lift_verdict import judge_lift
from dexnudge.simulation.push_forces import push_forces
from dexnudge.simulation.push_model import PushModel, load_push_model
from dexnudge.simulation.push_verdict import MOST_PENETRATION, MOST_SUNK, MOST_TURNED
from dexnudge.simulation.squeeze import squeeze

AIM = GraspableLimits(overhang=(0.40, 0.45))  # of the slide: what slips on the way comes off the overhang
REACHED = GraspableLimits(overhang=(0.30, 0.90))  # after it: far enough, and not tipping
MOST_CORRECTIONS = 3  # of a push whose object stays behind
CLOSE_BEHIND = 0.003  # [m] that an object may stay behind
MOST_BEHIND = 0.5  # of the way; an object that stays behind farther than that has been lost
LIFT = 0.10  # [m]
LIFT_SPEED = 0.10  # [m/s] in the middle of the lift
HOLD_TIME = 2.0  # [s]
CLOSE_RAMP, CLOSE_TIME, SETTLE_TIME = 0.1, 0.2, 0.1  # [s] as in the hold test
REST_TIME = 0.2  # [s] in which an object that was let go comes to rest
SQUEEZE_SHARE = 0.75  # of the hand's friction that the squeeze's forces use: 0.6 of 0.8, as in the hold test
MOST_PLANNED = 6  # hands that are planned for until one has a way
GRASP_BATCHES = 2  # of draws until one holds


@dataclass(frozen=True)
class Try:
    """One try.

    phase: where it failed, of "slide", "grasp search", "approach", "lift", "hold"; "" where the object was lifted and held.
    configuration: of the folder, that slid the object; -1 where it lay graspable already. overhang: free part of the
    object's length after the slide. grasps: found, so many of `drawn` so far. drift: of the grasp taken. raised, least_held
    [m], turned_deg: see `LiftVerdict`. NaN or -1 where it did not come to that.
    """

    number: int
    phase: str
    reason: str
    configuration: int = -1
    overhang: float = float("nan")
    grasps: int = -1
    drawn: int = -1
    drift: float = float("nan")
    raised: float = float("nan")
    least_held: float = float("nan")
    turned_deg: float = float("nan")
    hand_environment: float = float("nan")

    @property
    def success(self) -> bool:
        """Lifted and held."""
        return not self.phase


@dataclass(frozen=True)
class Story:
    """All tries, the trace of the whole simulation, and why there were no more tries, if not for success or their number."""

    tries: list[Try]
    trace: Trace | None
    ended: str
    last_state: Float[np.ndarray, " state"] | None
    grasps: list[Float[np.ndarray, " coordinates"]]


class SlideGraspLift:
    """Runs one story.

    Args:
        hand, scene: as read from the same files as the model.
        xml: what `push_model_xml(hand, scene)` made.
        q: configurations that were sampled for the scene's motion, in the order in which they are to be tried.
        indices: their numbers in the folder.
        sampler: of the same hand, with a prior that knows grasps.
        draws: of grasps at a time.
    """

    def __init__(
        self,
        hand: Hand,
        scene: Scene,
        xml: str,
        q: Float[np.ndarray, "n coordinates"],
        indices: Int[np.ndarray, " n"],
        sampler: Sampler,
        *,
        draws: int,
        seed: int,
    ) -> None:
        self._hand, self._first = hand, scene
        self._model = load_push_model(xml, hand, scene)
        self._finder = GraspFinder(hand, sampler, scene)
        self._waiting = dict(zip(indices.tolist(), np.asarray(q, dtype=np.float64), strict=True))
        self._draws, self._seed, self._drawn = draws, seed, 0
        self._grasps: list[Grasp] = []
        self._taken: list[np.ndarray] = []
        self._episode: Episode | None = None

    def run(self, tries: int) -> Story:
        """Try until the object is lifted and held, or cannot be reached any more."""
        done: list[Try] = []
        ended = ""
        while len(done) < tries and not ended and not (done and done[-1].success):
            number = len(done) + 1
            if self._episode is not None:
                self._episode.attempt = number
            done.append(self._try(number))
            ended = self._why_over()
        trace, state = None, None
        if self._episode is not None:
            trace, state = self._episode.trace, self._episode.last_state if self._episode.diverged else None
        return Story(done, trace, "" if done[-1].success else ended, state, self._taken)

    def _try(self, number: int) -> Try:
        scene, index = self._scene_now(), -1
        overhang = _overhang(scene)
        if overhang is None:
            index, reason = self._slide(scene)
            scene = self._scene_now() if self._episode else scene
            overhang = None if reason else _overhang(scene)
            if overhang is None:
                return Try(number, "slide", reason or _short(scene), index)
        grasp, approach, ways, phase, reason = self._choose_grasp(scene, number)
        found = Try(
            number,
            phase,
            reason,
            index,
            overhang,
            len(self._grasps),
            self._drawn,
            grasp.drift if grasp else float("nan"),
        )
        if grasp is None or approach is None:
            return found
        self._grasps = [other for other in self._grasps if other is not grasp]
        self._lift(scene, grasp, approach, ways)
        assert self._episode is not None
        verdict = judge_lift(self._episode.trace, attempt=number, height=LIFT)
        found = replace(found, **{name: getattr(verdict, name) for name in vars(verdict)})
        if self._episode.diverged:
            return replace(found, phase=found.phase or "hold", reason="the simulation diverged")
        if not found.success and not self._why_over():
            self._put_back(approach, ways)
        return found

    def _slide(self, scene: Scene) -> tuple[int, str]:
        """Push the object along the scene's motion; the configuration that did, and what went wrong."""
        plan = plan_object_motion(scene, AIM, own_motion_only=True)
        if isinstance(plan, NoObjectMotion):
            plan = plan_object_motion(scene, DEFAULT_LIMITS, own_motion_only=True)
        if isinstance(plan, NoObjectMotion):
            return -1, plan.reason
        index, q, approach, reason = self._choose_push(scene)
        if approach is None or approach.trajectory is None:
            return index, reason
        del self._waiting[index]
        before, times, way = _stretches(approach)
        if self._episode is None:
            self._episode = Episode(self._model, way[0])
        else:
            self._episode.play(along_way(*before), "transit")
        episode = self._episode
        (contacts,) = contacts_of(self._hand, scene, q[None])
        task = sliding_task(scene)
        with episode.elsewhere():
            forces = push_forces(self._model_at(scene), q, contacts, support_contacts(scene), task)
        episode.slide(push_drive(times, way, motion=task.motion, length=plan.length), forces)
        self._catch_up(scene, plan.length)
        self._back_off(times, way)
        return index, self._slide_reason(scene)

    def _catch_up(self, scene: Scene, length: float) -> None:
        """The hand goes on by as much as the object has stayed behind, as one that sees the object would."""
        assert self._episode is not None
        for _ in range(MOST_CORRECTIONS):
            moved = sliding_task(self._scene_now()).centre - sliding_task(scene).centre
            behind = length - float(moved @ scene.motion)
            if not CLOSE_BEHIND < behind < MOST_BEHIND * length:
                return
            way = along_line(self._episode.told, behind * scene.motion, speed=SPEED)
            self._episode.carry_on(way, "push")

    def _choose_push(self, scene: Scene) -> tuple[int, np.ndarray, Approach | None, str]:
        """The first configuration that fits the object where it lies now and has a way there."""
        moved = scene.T_world_object @ np.linalg.inv(self._first.T_world_object)
        planner = ApproachPlanner(self._hand, scene)
        reason = "no configuration of the folder is left"
        for index, first in list(self._waiting.items())[:MOST_PLANNED]:
            q = np.asarray(transform_configurations(moved, first[None])[0])
            if self._episode is not None:
                verdict = judge(self._hand, scene, q[None])
                if not verdict.success[0]:
                    reason = f"configuration {index} no longer fits: {verdict.reason[0]}"
                    continue
            approach = planner.plan(q, start=self._episode.q if self._episode else None)
            if approach.blocked is None:
                return index, q, approach, ""
            reason = f"approach blocked: {approach.blocked.reason}"
        return -1, np.zeros(0), None, reason

    def _slide_reason(self, before: Scene) -> str:
        assert self._episode is not None
        if self._episode.diverged:
            return "the simulation diverged"
        trace = self._episode.trace
        depth = trace.hand_environment_depth[trace.attempt == self._episode.attempt].max()
        now = self._episode.T_world_object
        tilt = np.degrees(np.arccos(np.clip((now @ np.linalg.inv(before.T_world_object))[2, 2], -1.0, 1.0)))
        if self._sunk() > MOST_SUNK:
            return "the object fell"
        if tilt > MOST_TURNED:
            return f"the object tipped by {tilt:.0f} deg"
        if depth > MOST_PENETRATION:
            return f"hand {1e3 * depth:.1f} mm into the environment"
        return ""

    def _choose_grasp(
        self, scene: Scene, number: int
    ) -> tuple[Grasp | None, Approach | None, list[np.ndarray], str, str]:
        """The best grasp that the hand can reach from where it is, and lift; else where and why there is none."""
        self._grasps = self._finder.still_clean(scene, self._grasps)
        rejected: dict[str, int] = {}
        for batch in range(GRASP_BATCHES):
            if self._grasps:
                break
            found = self._finder.find(scene, num=self._draws, seed=self._seed + GRASP_BATCHES * number + batch)
            self._drawn += found.drawn
            self._grasps = found.grasps
            rejected = found.rejected
        if not self._grasps:
            text = ", ".join(
                f"{reason} {count}" for reason, count in sorted(rejected.items(), key=lambda item: -item[1])
            )
            return None, None, [], "grasp search", f"no grasp found in {self._drawn} draws: {text}"
        planner, up = ApproachPlanner(self._hand, scene), LiftWay(self._hand, scene, height=LIFT)
        reasons = []
        for grasp in self._grasps[:MOST_PLANNED]:
            q = grasp.in_world(scene.T_world_object)
            ways = up(q)
            if ways is None:
                reasons.append("nowhere to lift to")
                continue
            approach = planner.plan(q, start=self._episode.q if self._episode else None)
            if approach.blocked is None:
                return grasp, approach, ways, "", ""
            reasons.append(f"{approach.blocked.stage}: {approach.blocked.reason}")
        return None, None, [], "approach", f"approach blocked ({len(reasons)} grasps): {reasons[0]}"

    def _lift(self, scene: Scene, grasp: Grasp, approach: Approach, ways: list[np.ndarray]) -> None:
        """Go there, close, lift, hold."""
        before, times, way = _stretches(approach)
        if self._episode is None:
            self._episode = Episode(self._model, before[1][0])
        episode = self._episode
        self._taken.append(way[-1])
        episode.play(along_way(*before), "transit")
        episode.play(along_way(times, way), "reach")
        pose = scene.T_world_object
        contacts = HandContacts(
            points=grasp.contacts.points @ pose[:3, :3].T + pose[:3, 3],
            normals=grasp.contacts.normals @ pose[:3, :3].T,
            link=grasp.contacts.link,
        )
        task = sliding_task(scene)
        with episode.elsewhere():
            model = self._model_at(scene)
            model.place(way[-1])
            wanted = squeeze(
                model, contacts, half_length=task.half_length, friction=SQUEEZE_SHARE * scene.friction_hand
            )
        episode.close(wanted.motor_torque, "close", ramp=CLOSE_RAMP, seconds=CLOSE_TIME)
        episode.play(waiting(episode.told, seconds=SETTLE_TIME), "close")
        for one in ways:
            episode.play(along_line(episode.told, one, speed=LIFT_SPEED), "lift")
        episode.play(waiting(episode.told, seconds=HOLD_TIME), "hold")

    def _put_back(self, approach: Approach, ways: list[np.ndarray]) -> None:
        """Down again, let go, and back off."""
        assert self._episode is not None
        for one in reversed(ways):
            self._episode.play(along_line(self._episode.told, -one, speed=LIFT_SPEED), "lower")
        self._episode.let_go()
        _, times, way = _stretches(approach)
        self._back_off(times, way)

    def _back_off(self, times: np.ndarray, way: np.ndarray) -> None:
        """The last stretch of the approach backward, from where the hand is told to be, and on to where it can open."""
        assert self._episode is not None
        back = way[::-1].copy()
        back[:, :3] += self._episode.told[:3] - way[-1, :3]
        self._episode.play(along_way(times, back), "release")
        self._episode.play(waiting(self._episode.told, seconds=REST_TIME), "release")
        if self._episode.diverged or self._sunk() > MOST_SUNK:
            return
        way_out = retreat(self._hand, self._scene_now(), self._episode.q)
        if way_out is not None and way_out.any():
            self._episode.play(along_line(self._episode.told, way_out, speed=LIFT_SPEED), "release")

    def _scene_now(self) -> Scene:
        if self._episode is None:
            return self._first
        return replace(self._first, T_world_object=self._episode.T_world_object)

    def _model_at(self, scene: Scene) -> PushModel:
        return replace(self._model, T_world_object=scene.T_world_object)

    def _sunk(self) -> float:
        """How far the object's centre of mass is below where it lay first [m]; a motion downhill is no sinking."""
        assert self._episode is not None
        centre = sliding_task(self._scene_now()).centre - sliding_task(self._first).centre
        motion = self._first.motion
        return float(motion[2] * (centre @ motion) - centre[2])

    def _why_over(self) -> str:
        """Why no further try can be made; "" if one can."""
        if self._episode is None:
            return "nothing could be played"
        if self._episode.diverged:
            return "the simulation diverged"
        return "the object fell" if self._sunk() > MOST_SUNK else ""


def _overhang(scene: Scene) -> float | None:
    """Free part of the object's length if it is graspable where it lies."""
    plan = plan_object_motion(scene, REACHED, own_motion_only=True)
    return plan.overhang if not isinstance(plan, NoObjectMotion) and plan.length == 0.0 else None


def _short(scene: Scene) -> str:
    plan = plan_object_motion(scene, REACHED, own_motion_only=True)
    if isinstance(plan, NoObjectMotion):
        return plan.reason
    return f"stopped {1e3 * plan.length:.0f} mm short of {REACHED.overhang[0]:.0%} overhang"


Timed = tuple[np.ndarray, np.ndarray]  # times [s] and q


def _stretches(approach: Approach) -> tuple[Timed, np.ndarray, np.ndarray]:
    """(times, q) up to pre-contact, times from there, q from there."""
    assert approach.trajectory is not None
    times, q = approach.trajectory.times, approach.trajectory.q
    late = times >= approach.pre_contact_time - 1e-9
    early = times <= times[late][0]
    return (times[early], q[early]), times[late] - times[late][0], q[late]
