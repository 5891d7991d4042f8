"""What came of playing configurations out in physics: watched, saved, and judged by its outcome."""

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from dexnudge.errors import InputError, check_integer, check_kind, check_seed, quote
from dexnudge.execution.episode_files import ARRAYS, forces_of_acts, forces_used, write_arrays, write_figures
from dexnudge.execution.executor import Execution, Executor, chosen_policy
from dexnudge.execution.film import film_of_trace, save_film, write_film
from dexnudge.execution.slide_grasp_lift import GRASP_DRAWS, Attempt, SlideGraspLift, SlideGraspLiftResult
from dexnudge.geometry.devices import own_modes
from dexnudge.jobs.folders import new_folder
from dexnudge.jobs.provenance import machine, versions
from dexnudge.planning.approach import Approach
from dexnudge.planning.outcomes import Outcome
from dexnudge.results.folder import SUMMARY, write_summary
from dexnudge.results.samples import Sample
from dexnudge.sampling.sampler import LARGEST_CALL, Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.feedback import Feedback
from dexnudge.simulation.hand_path import rotations
from dexnudge.simulation.model import TIMESTEP, SimulationModel, scene_model
from dexnudge.simulation.policy import Policy
from dexnudge.simulation.rollout import Divergence, Trace
from dexnudge.simulation.success import PushVerdict
from dexnudge.viewer.recording import Recording

MODEL_FILE = "scene.xml"
EPISODE_FILES = (SUMMARY, *(f"{folder}{name}.*" for folder in ("", "configuration_*/") for name in ("episode", "film")))
"""What else a folder of episodes consists of, as patterns of paths."""
KEY_INTERVAL = 0.25  # [s] between two key frames


@dataclass(frozen=True, eq=False, repr=False)
class Episode:
    """A configuration played out in physics: a push, or all attempts to slide, grasp and lift.

    Attributes:
        scene: the scene in which it was played.
        simulation: the model of the scene in MuJoCo.
        result: what the push, or what each attempt to slide, grasp and lift, found in detail.
        policy: class of what decided step by step; see `Policy`.
        configuration: number, among those given, of the one that pushed.
    """

    scene: Scene
    simulation: SimulationModel
    result: Execution | SlideGraspLiftResult
    policy: str
    configuration: int = 0

    @property
    def outcome(self) -> Outcome:
        """How it ended; its `sentence` says it in words."""
        return (self.result.verdict if isinstance(self.result, Execution) else self.result.attempts[-1]).outcome

    @property
    def detail(self) -> str:
        """What the outcome leaves open, for people; often empty."""
        if not isinstance(self.result, Execution):
            return self.result.attempts[-1].detail
        drifted = [f"{1e3 * self.result.verdict.aside:.1f} mm"] * (self.outcome is Outcome.DRIFTED)
        times = self.result.took_hold_again
        again = [f"took hold again {times} time{'s' * (times > 1)}"] * (times > 0)
        own, first = self.configuration, self.result.number_of_first(self.configuration)
        why = f"{own} did not hold when rehearsed" if self.result.failed_rehearsal else f"no free way leads to {own}"
        other = [f"began with configuration {first}, as {why}"] * (first != own)
        if first == own and self.result.failed_rehearsal:
            other = ["neither it nor another held when rehearsed"]
        return ", ".join(other + drifted + again)

    @property
    def success(self) -> bool:
        """Whether the object was pushed to where it should be, or lifted and held."""
        return self.outcome is Outcome.SUCCESS

    @property
    def length_asked(self) -> float:
        """Length of the push or of the last slide [m]; 0 where the object was grasped where it lay."""
        return self._pushed.length_asked or 0.0

    @property
    def length_reached(self) -> float:
        """How far the object's centre of mass moved along the motion in that push or slide [m]."""
        return self._pushed.length_reached or 0.0

    @property
    def angle_asked(self) -> float:
        """Angle by which the push should turn the object [rad]; 0 where it should only slide."""
        return self.result.verdict.angle_asked if isinstance(self.result, Execution) else 0.0

    @property
    def angle_reached(self) -> float:
        """By how much the push turned it about the axis of that turn [rad]; 0 where it should only slide."""
        return self.result.verdict.angle_reached if isinstance(self.result, Execution) else 0.0

    @property
    def _pushed(self) -> PushVerdict | Attempt:
        if isinstance(self.result, Execution):
            return self.result.verdict
        attempts = self.result.attempts
        return next((one for one in reversed(attempts) if one.length_asked is not None), attempts[-1])

    @property
    def trace(self) -> Trace | None:
        """Records 20 ms apart; None where nothing could be played."""
        return self.result.trace

    @property
    def divergence(self) -> Divergence | None:
        """Where the simulation diverged; None where it did not."""
        return self.result.divergence

    def __repr__(self) -> str:
        kind = "Push" if isinstance(self.result, Execution) else "Slide, grasp and lift"
        number = 0 if isinstance(self.result, Execution) else len(self.result.attempts)
        attempts = f", {number} attempt{'s' * (number > 1)}" if number else ""
        detail = f" ({self.detail})" if self.detail else ""
        turned = f"{np.degrees(self.angle_reached):.1f} deg, {np.degrees(self.angle_asked):.0f} asked"
        slid = f"{1e3 * self.length_reached:.1f} mm, {round(1e3 * self.length_asked)} asked"
        made = " and ".join(
            [turned] * (self.angle_asked > 0) + [slid] * (self.length_asked > 0 or not self.angle_asked)
        )
        return (
            f"{kind} of {self.simulation.hand.name} in '{self.scene.name}': {self.outcome.sentence}{detail}; "
            f"{made}{attempts}"
        )

    def recording(self, title: str = "") -> Recording:
        """Return the film of the episode.

        Raises:
            InputError: nothing could be played.
        """
        if self.trace is None:
            raise InputError(
                f"there is no film where nothing was played: {self.outcome.sentence} {self.detail}".strip()
            )
        subtitle = repr(self).partition(": ")[2]
        return film_of_trace(
            self.scene,
            self.simulation,
            self.trace,
            title=title,
            subtitle=subtitle,
            success=self.success,
            length=self.length_asked or None,
        )

    @own_modes()
    def film(self, path: Path | str, *, title: str = "") -> Path:
        """Write the episode as an animation (.gif), a strip of pictures (.png), or a 3-D page to play (.html).

        Raises:
            InputError: another suffix, or nothing could be played.
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
            self.write_all(written, pictures=pictures)
        return folder

    def write_all(
        self, folder: Path, *, title: str = "", pictures: bool = True, details: dict[str, Any] | None = None
    ) -> dict[str, Any]:
        """Write the same into a folder that exists; return the summary, which ends with `details`."""
        self.write(folder, title=title, pictures=pictures)
        write_model({self.configuration: self.trace}, folder, xml=self.simulation.xml)
        summary = self.summary() | (details or {}) | provenance()
        write_summary(folder, summary)
        return summary

    def write(self, folder: Path, *, title: str = "", pictures: bool = True) -> None:
        """Write episode.json, episode.npz and the film into a folder, made where it is missing.

        episode.npz: see `write_arrays`. Of a push also what was planned: planned_force, planned_motor_torque and
        planned_base_wrench, those of PushForces by place of the way; approach_time and approach_q, the way to contact. Of a
        simulation that diverged `state`, MuJoCo's mjSTATE_INTEGRATION after `last_step` steps, and the step `diverged_at`.
        """
        folder.mkdir(parents=True, exist_ok=True)
        write_figures(folder, self.outcome, self.summary())
        if self.trace is None:
            return
        further: dict[str, Any] = {}
        if isinstance(self.result, Execution):
            forces = self.result.forces
            further |= {"planned_force": forces.force, "planned_motor_torque": forces.motor_torque}
            further["planned_base_wrench"] = forces.base_wrench
            if isinstance(self.result.approach, Approach):
                way = self.result.approach.trajectory
                further |= {"approach_time": way.times, "approach_q": way.q}
        if self.divergence is not None:
            found = self.divergence
            further |= {"state": found.state, "last_step": found.last_step, "diverged_at": found.step}
        palms = np.tile(np.eye(4), (len(self.trace.time), 1, 1))
        q = self.simulation.configurations(self.trace.qpos)
        palms[:, :3, :3], palms[:, :3, 3] = rotations(q).as_matrix(), q[:, :3]
        write_arrays(folder, self.simulation, self.trace, T_world_palm=palms, **further)
        write_film(self.recording(title), folder, pictures=pictures)

    def summary(self) -> dict[str, Any]:
        """Return outcome and figures as a JSON object; lengths in metres.

        angle_asked, angle_reached: turn about the motion's axis [rad]. Of a push turned_deg: by how much the object's
        orientation was off that of its motion, at most [deg]. policy: class of what decided step by step.
        """
        result, trace = self.result, self.trace
        shared = {
            "success": self.success,
            "outcome": self.outcome.value,
            "sentence": self.outcome.sentence,
            "detail": self.detail,
            "policy": self.policy,
            "length_asked": self.length_asked,
            "length_reached": self.length_reached,
            "angle_asked": self.angle_asked,
            "angle_reached": self.angle_reached,
            "trace": None if trace is None else ARRAYS,
            "simulated_seconds": 0.0 if trace is None else float(trace.time[-1]),
            **({} if trace is None else forces_used(self.scene, self.simulation, trace)),
        }
        if isinstance(result, SlideGraspLiftResult):
            return shared | {
                **({} if trace is None else forces_of_acts(self.simulation, trace)),
                "success_first_attempt": result.attempts[0].success,
                "ended": None if result.ended is None else result.ended.value,
                "attempts": [{"success": one.success, **asdict(one)} for one in result.attempts],
            }
        approach, verdict = result.approach, result.verdict
        return {
            "configuration": self.configuration,
            "began_with": result.number_of_first(self.configuration),
            **shared,
            "turned_deg": verdict.turned_deg,
            "sunk": verdict.sunk,
            "aside": verdict.aside,
            "hand_environment": verdict.hand_environment,
            "approach": approach.planner
            if isinstance(approach, Approach)
            else f"none, starts at contact: {approach.reason}",
            "cone_share": float(result.forces.cone_share[0]),
            "diverged_at": -1 if result.divergence is None else result.divergence.step,
            "seconds": {stage: round(value, 4) for stage, value in result.seconds.items()},
        }


@own_modes()
def execute(
    sample: Sample,
    *,
    feedback: Policy | bool = True,
    then_grasp: bool = False,
    alternatives: Iterable[Sample] = (),
    attempts: int = 3,
    draws: int = GRASP_DRAWS,
    seed: int = 0,
    weights: Path | str | None = None,
) -> Episode:
    """Play a configuration out in MuJoCo: close in, squeeze, and push the object by the length of the scene's motion.

    Args:
        sample: a configuration in its scene, such as `samples[0]`. One that was rejected is played, too, with a warning.
        feedback: whether the hand answers what it feels and sees, see `Feedback`; False for the plan as it is, or a policy
            of your own.
        then_grasp: slide the object until it can be grasped, grasp it, lift it by 10 cm and hold it for 2 s.
        alternatives: configurations of the same scene with which a push begins to whose own no free way leads, or whose
            turn does not hold when it is rehearsed, and with which one that falls short goes on; with
            `then_grasp`, with which further attempts push. Without any, `Feedback` goes on with the configuration itself,
            and a policy of your own ends where it returns None.
        attempts: with `then_grasp`, at most so many; each goes on from where the one before left hand and object. A slide
            that stops short goes on as a push does, and spends none, up to seven times.
        draws: with `then_grasp`, the number of grasps that are sampled at a time; 32 unless given.
        seed: with `then_grasp`, the seed of the grasps.
        weights: folder of the model that draws them; None for the one that ships for this hand.

    Raises:
        InputError: `sample` or `feedback` is something else, an alternative is of another scene or hand, `attempts`, `draws`
            or `seed` is out of range, or what the policy commands is no `Command` of finite numbers.
        CheckpointError: no weights for this hand, or weights that are broken or made for another.
        MeshError: MuJoCo cannot take the object or the surroundings.
    """
    check_kind("sample", sample, Sample, "samples[0]")
    if not isinstance(alternatives, Iterable):
        raise InputError(f"`alternatives` is {quote(alternatives)}; expected samples of one scene, such as samples[1:]")
    alternatives = tuple(alternatives)
    for each in alternatives:
        check_kind("alternatives", each, Sample, "samples[1]")
        if not each.scene.lies_as(sample.scene) or each.hand.joint_names != sample.hand.joint_names:
            raise InputError(
                "`alternatives` has a configuration of another scene or hand than `sample`; expected samples of one scene, "
                "such as samples[1:]"
            )
    check_integer("attempts", attempts, least=1)
    check_integer("draws", draws, least=1, most=LARGEST_CALL)
    check_seed(seed)
    policy = chosen_policy(feedback)
    if not sample.success:
        warnings.warn(
            f"the configuration was rejected for '{sample.reason}'; it is executed all the same", stacklevel=2
        )
    q = np.stack([np.asarray(each.q, dtype=np.float64) for each in (sample, *alternatives)])
    if not then_grasp:
        simulation = scene_model(sample.hand, sample.scene)
        goes_on = feedback is not False and (isinstance(policy, Feedback) or len(alternatives) > 0)
        execution = Executor(sample.scene, simulation, policy)(q[0], q[1:] if goes_on else None)
        return Episode(sample.scene, simulation, execution, type(policy).__name__)
    sampler = Sampler.from_pretrained(sample.hand, weights=weights)
    simulation = scene_model(sample.hand, sample.scene)
    result = SlideGraspLift(sample.scene, simulation, q, sampler, draws=draws, seed=seed, policy=policy).run(attempts)
    used = next((one.configuration for one in result.attempts if one.configuration >= 0), 0)
    return Episode(sample.scene, simulation, result, type(policy).__name__, used)


def provenance() -> dict[str, Any]:
    """Return the entries that every summary ends with."""
    return {"timestep": TIMESTEP, "machine": machine(), "versions": versions()}


def write_model(traces: Mapping[int, Trace | None], folder: Path, *, xml: str) -> None:
    """Write the model that was simulated, with key frames every 0.25 s of the traces, by configuration, and at their ends.

    `python -m mujoco.viewer --mjcf=scene.xml` opens it; its key frames step through what happened.
    """
    root = ElementTree.fromstring(xml)  # noqa: S314 - the text is our own
    keys = ElementTree.SubElement(root, "keyframe")
    for configuration, trace in sorted(traces.items()):
        if trace is None:
            continue
        shown = np.searchsorted(trace.time, np.arange(0.0, trace.time[-1], KEY_INTERVAL) - 1e-9)
        for record in np.unique([*shown, len(trace.time) - 1]):
            values = {
                "time": trace.time[record],
                "qpos": trace.qpos[record],
                "ctrl": trace.ctrl[record],
            }
            if trace.mocap.size:
                values |= {"mpos": trace.mocap[record, :3], "mquat": trace.mocap[record, 3:]}
            # Milliseconds: records are 2 ms apart at least, and MuJoCo loads no two keys of one name.
            name = f"configuration {configuration} at {trace.time[record]:.3f} s"
            key = ElementTree.SubElement(keys, "key", name=name)
            for attribute, value in values.items():
                key.set(attribute, " ".join(f"{x:.9g}" for x in np.atleast_1d(value)))
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(folder / MODEL_FILE, encoding="utf-8")
