"""What came of playing a plan in physics: judged, watched, saved."""

from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from dexnudge.execution.episode import EPISODE_FILES, MODEL_FILE, provenance, write_model
from dexnudge.execution.episode_files import ARRAYS, forces_used, write_arrays, write_figures
from dexnudge.execution.film import film_of_trace, save_film, write_film
from dexnudge.execution.grasp_and_lift import HOLD_TIME, LIFT
from dexnudge.geometry.devices import own_modes
from dexnudge.jobs.folders import new_folder
from dexnudge.planning.outcomes import Outcome
from dexnudge.results.folder import write_summary
from dexnudge.simulation.robot_model import RobotModel, load_robot_model, robot_model
from dexnudge.simulation.rollout import Divergence, Trace
from dexnudge.simulation.success import LiftVerdict, PushVerdict, judge_lift, judge_push
from dexnudge.trajectories.plan import Plan
from dexnudge.trajectories.plan_reader import check_phases
from dexnudge.trajectories.playback import PlanRollout, PlanTrace
from dexnudge.viewer.recording import Recording

PUSH_PHASES = ("pre-contact", "contact", "squeeze", "push")  # in which the arrow shows where the object shall go


@dataclass(frozen=True, eq=False, repr=False)
class PlanEpisode:
    """A plan played out in physics by the motors of arm and hand.

    Attributes:
        plan: the plan.
        model: robot and scene in MuJoCo.
        trace: records 20 ms apart.
        divergence: where the simulation diverged; None where it did not.
        verdict: on the push, up to its end, and if it succeeded also after the hand has withdrawn.
        lift: verdict on the lift; None where the plan has none.
    """

    plan: Plan
    model: RobotModel
    trace: PlanTrace
    divergence: Divergence | None
    verdict: PushVerdict
    lift: LiftVerdict | None = None

    @property
    def outcome(self) -> Outcome:
        """How it ended; its `sentence` says it in words."""
        return self.lift.outcome if self.lift is not None and self.verdict.success else self.verdict.outcome

    @property
    def success(self) -> bool:
        """Whether the object was pushed to where it should be, and lifted and held where the plan says so."""
        return self.outcome is Outcome.SUCCESS

    @property
    def length_asked(self) -> float:
        """Length of the push [m]."""
        return self.plan.length

    @property
    def length_reached(self) -> float:
        """How far the object's centre of mass moved along the motion [m]."""
        return self.verdict.length_reached

    @property
    def configuration(self) -> int:
        """Number of the configuration, among the samples that were planned for."""
        return self.plan.phases[0].configuration

    @property
    def delay(self) -> float:
        """By how much the joints are behind the plan [s]: the shift that explains most of the tracking error."""
        moving = float((self.trace.velocity**2).sum())
        return -float((self.trace.tracking_error * self.trace.velocity).sum()) / moving if moving > 0 else 0.0

    def __repr__(self) -> str:
        return (
            f"Push by {self.plan.robot!r} in '{self.plan.scene.name}': {self.outcome.sentence}; "
            f"{1e3 * self.length_reached:.1f} mm, {round(1e3 * self.length_asked)} asked"
        )

    def recording(self, title: str = "") -> Recording:
        """Return the film of the episode."""
        subtitle = repr(self).partition("': ")[2]
        return film_of_trace(
            self.plan.scene,
            self.model.simulation,
            self.trace,
            title=title,
            subtitle=subtitle,
            success=self.success,
            length=self.length_asked,
            push_phases=PUSH_PHASES,
        )

    @own_modes()
    def film(self, path: Path | str, *, title: str = "") -> Path:
        """Write the episode as an animation (.gif), a strip of pictures (.png), or a 3-D page to play (.html).

        Raises:
            InputError: another suffix.
            OutputError: the file cannot be written.
        """
        return save_film(self.recording(title), path)

    @own_modes()
    def save(self, folder: Path | str, *, overwrite: bool = False, pictures: bool = True) -> Path:
        """Write scene.xml, episode.npz, episode.json, the film and summary.json into a new folder.

        Raises:
            OutputError: the folder exists without `overwrite`, or cannot be written.
        """
        folder = Path(folder)
        with new_folder(folder, overwrite=overwrite, marker=MODEL_FILE, ours=EPISODE_FILES) as written:
            write_figures(written, self.outcome, self.summary())
            simulation, robot = self.model.simulation, self.plan.robot
            palms = robot.palm_poses(self.model.positions(self.trace.qpos))
            write_arrays(written, simulation, self.trace, T_world_palm=palms)
            write_film(self.recording(), written, pictures=pictures)
            write_model({self.configuration: self.trace}, written, xml=self.model.simulation.xml)
            write_summary(written, self.summary() | provenance())
        return folder

    def summary(self) -> dict[str, Any]:
        """Return outcome and figures as a JSON object; lengths in metres, angles in radians unless they say degrees.

        `phases` holds for each phase the greatest tracking error of the palm, of the arm's joints and of the hand's, the
        greatest share of its limit that a motor's torque took, and the mean normal force on the object [N].
        """
        verdict, trace = self.verdict, self.trace
        return {
            "configuration": self.configuration,
            "success": self.success,
            "outcome": self.outcome.value,
            "sentence": self.outcome.sentence,
            "length_asked": self.length_asked,
            "length_reached": self.length_reached,
            "turned_deg": verdict.turned_deg,
            "sunk": verdict.sunk,
            "hand_environment": verdict.hand_environment,
            **({} if self.lift is None else {"lift": asdict(self.lift)}),
            "delay": self.delay,
            "phases": [{"name": str(name)} | self._figures(trace.phase == name) for name in dict.fromkeys(trace.phase)],
            "trace": ARRAYS,
            **forces_used(self.plan.scene, self.model.simulation, trace),
            "simulated_seconds": float(trace.time[-1]),
            "diverged_at": -1 if self.divergence is None else self.divergence.step,
        }

    def _figures(self, records: Bool[np.ndarray, " record"]) -> dict[str, float]:
        trace, arm = self.trace, self.plan.robot.arm.num_joints
        off = np.abs(trace.tracking_error[records])
        return {
            "palm_error": float(trace.palm_error[records, 0].max()),
            "palm_error_deg": float(np.degrees(trace.palm_error[records, 1].max())),
            "arm_error": float(off[:, :arm].max()),
            "hand_error": float(off[:, arm:].max(initial=0.0)),
            "arm_torque_share": float(trace.torque_share[records, :arm].max()),
            "hand_torque_share": float(trace.torque_share[records, arm:].max(initial=0.0)),
            "hand_object_force": float(trace.hand_object_force[records, 0].mean()),
        }


@own_modes()
def execute_plan(plan: Plan, *, xml: str | None = None) -> PlanEpisode:
    """Play a plan out in MuJoCo by the motors of arm and hand.

    Args:
        plan: the plan.
        xml: the model of its robot and scene, of an episode before; None: made anew.

    Raises:
        InputError: the phases are no push, or `xml` is no such model.
        MeshError: MuJoCo cannot take the object or the surroundings.
    """
    check_phases(plan.phases, plan.length, plan.scene, "plan")
    model = robot_model(plan.robot, plan.scene) if xml is None else load_robot_model(xml, plan.robot)
    rollout = PlanRollout(model, plan.trajectory.position[0])
    rollout.follow_plan(plan)
    trace, divergence = rollout.plan_trace, rollout.divergence
    diverged = divergence is not None
    verdict = judge_plan(plan, trace, diverged=diverged)
    lifts = verdict.success and not diverged and plan.phases[-1].name == "lift"
    return PlanEpisode(plan, model, trace, divergence, verdict, judge_plan_lift(trace) if lifts else None)


def judge_plan_lift(trace: PlanTrace) -> LiftVerdict:
    """Judge the lift at the end of a plan as `judge_lift` does; the last two seconds are those in which it is held."""
    phase = np.where(trace.phase == "regrasp", "reach", trace.phase)
    phase = np.where((phase == "lift") & (trace.time > trace.time[-1] - HOLD_TIME), "hold", phase)
    return judge_lift(replace(trace, phase=phase), attempt=1, height=LIFT)


def judge_plan(plan: Plan, trace: PlanTrace, *, diverged: bool) -> PushVerdict:
    """Judge the push of a plan at its end and once the hand has withdrawn: the first that fails, else the former."""
    verdicts, ends = [], {phase.name: phase.end for phase in plan.phases}
    for last in ("push", "retreat"):
        end = ends[last] - plan.trajectory.time[0]
        verdicts.append(
            judge_push(
                _until(trace, end),
                motion=plan.scene.object_motion,
                length=plan.length,
                max_normal_force=plan.scene.max_normal_force,
                diverged=diverged,
            )
        )
    return next((verdict for verdict in verdicts if not verdict.success), verdicts[0])


def _until(trace: PlanTrace, end: float) -> Trace:
    """Return the records up to a time [s]; the first one at least."""
    count = max(1, int(np.searchsorted(trace.time, end + 1e-6)))
    return Trace(**{field.name: getattr(trace, field.name)[:count] for field in fields(Trace)})
