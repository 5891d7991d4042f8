"""What can be played: episodes that were executed, plans, and the motion that a draw is meant to make."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from dexnudge.arms.robot import Robot
from dexnudge.errors import LONGEST_NAME, InputError
from dexnudge.execution.episode_files import ARRAYS, FIGURES, read_episode
from dexnudge.execution.film import with_object_at
from dexnudge.hands.hand import Hand
from dexnudge.jobs.json_files import read_json_object
from dexnudge.results.samples import Sample
from dexnudge.scenes.scene import Scene
from dexnudge.trajectories.plan import Plan
from dexnudge.trajectories.plan_film import film_of_plan
from dexnudge.trajectories.plan_folder import PLAN, load_plan
from dexnudge.viewer.recording import Curve, Recording
from dexnudge.viewer.visual_scene import VisualScene, visual_scenes

FORCES = "links on object"  # title of the chart that holds the links' forces
SPEED = 0.05  # [m/s] at which an object is carried along its motion
Recordings = dict[str, Callable[[], Recording]]


def recordings(folder: Path, scene: Scene, hand: Hand) -> Recordings:
    """Return the episodes and plans of a folder and of those inside it, by name; each is read when it is called."""
    found: Recordings = {}
    for depth in ("", "*/", "*/*/"):
        for file in sorted(folder.glob(depth + ARRAYS)):
            if not any((above / PLAN).is_file() for above in (file.parent, *file.parents[1:3])):
                found[_name(file.parent, folder)] = partial(episode_recording, file.parent, scene, hand)
    for depth in ("", "*/"):
        for file in sorted(folder.glob(depth + PLAN)):
            found |= plan_recordings(file.parent, folder)
    return found


def plan_recordings(folder: Path, top: Path) -> Recordings:
    """Return what a plan intends, and its episodes inside its folder."""
    name, episodes = _name(folder, top), sorted(folder.glob(f"*/{ARRAYS}"))
    played = {f"{name}, {file.parent.name}": partial(_played_plan, file.parent, folder) for file in episodes}
    return {name: lambda: intended(load_plan(folder)), **played}


def _name(folder: Path, top: Path) -> str:
    return "/".join(folder.relative_to(top).parts) or folder.resolve().name


def _played_plan(folder: Path, plan_folder: Path) -> Recording:
    plan = load_plan(plan_folder)
    return episode_recording(folder, plan.scene, plan.robot.body, robot=plan.robot)


def episode_recording(folder: Path, scene: Scene, hand: Hand, *, robot: Robot | None = None) -> Recording:
    """Return an episode that was executed, from its episode.npz; its chart holds the force of each link that touches.

    Its subtitle says how it ended, as episode.json does; empty without that.

    robot: where `hand` is the body of one.

    Raises:
        InputError: the file is missing, damaged, or of another hand.
    """
    arrays = read_episode(folder)
    joints, links = arrays["joint_names"].tolist(), arrays["link_names"].tolist()
    if joints != list(hand.joint_names) or links != list(hand.link_names):
        raise InputError(
            f"{folder.name}/{ARRAYS} is of a hand with the joints {', '.join(joints)}; expected those of {hand.name}, "
            f"{', '.join(hand.joint_names)}; execute the result again"
        )
    angles, palm = arrays["joint_angles"], arrays["T_world_palm"]
    q = np.concatenate([palm[:, :3, 3], palm[:, :3, 0], palm[:, :3, 1], angles], axis=1)
    drawn = visual_scenes(scene, hand, q if robot is None else robot.coordinates(angles))
    frames = [
        with_object_at(frame, pose, moving=True) for frame, pose in zip(drawn, arrays["T_world_object"], strict=True)
    ]
    forces = dict(zip(links, arrays["link_force"].T, strict=True))
    ended = read_json_object(folder / FIGURES, error=InputError) if (folder / FIGURES).is_file() else {}
    outcome = str(ended.get("sentence", ""))[:LONGEST_NAME]
    return replace(_recording(frames, arrays["time"], arrays["phase"].tolist(), forces), subtitle=outcome)


def intended(plan: Plan) -> Recording:
    """Return what a plan intends, with the forces that its phases ask for."""
    film = film_of_plan(plan)
    of_phase = {phase.name: phase.link_force for phase in plan.phases}
    links = {link for phase in plan.phases for link in phase.link_force}
    forces = {link: np.array([of_phase[name].get(link, 0.0) for name in film.phase]) for link in sorted(links)}
    return _recording(film.frames, film.time, film.phase, forces)


def carried(sample: Sample) -> Recording:
    """Return the motion that a draw is meant to make: the hand goes along with the object, without physics."""
    motion = sample.scene.object_motion
    still = visual_scenes(sample.scene, sample.hand, sample.q[None].astype(np.float64))[0]
    ways = np.linspace(0.0, motion.length, max(2, round(25 * motion.length / SPEED)))
    moves = ("object", "link", "fingertip", "base", "arm")
    frames = []
    for T in map(motion.displacement, ways):
        parts = (
            replace(part, T_world_part=T @ part.T_world_part) if part.role in moves else part for part in still.parts
        )
        frames.append(replace(still, parts=tuple(parts)))
    return _recording(frames, ways / SPEED, [""] * len(ways), {})


def _recording(
    frames: Sequence[VisualScene],
    time: Float[np.ndarray, " k"],
    phase: Sequence[str],
    forces: dict[str, Float[np.ndarray, " k"]],
) -> Recording:
    curves = tuple(Curve(name, "N", values) for name, values in forces.items() if values.any())
    return Recording(frames, time, phase, {FORCES: curves})


def frame_at(recording: Recording, seconds: float) -> int:
    """Return the moment that is shown at a time [s]: the last one that is not later."""
    return int(np.clip(np.searchsorted(recording.time, seconds + 1e-9, side="right") - 1, 0, len(recording.time) - 1))


def forces_at(recording: Recording, frame: int) -> dict[str, float]:
    """Return what each link presses with at a moment [N], strongest first."""
    found = {curve.name: float(curve.values[frame]) for curve in recording.charts.get(FORCES, ())}
    return dict(sorted(found.items(), key=lambda item: -item[1]))


@dataclass
class Player:
    """A recording at a moment.

    Attributes:
        name: as it was chosen; "" where nothing is played.
        recording: what is played.
        time: of the moment that is shown [s].
        speed: seconds of the recording in each second.
        running: whether it goes on by itself.
    """

    name: str = ""
    recording: Recording | None = None
    time: float = 0.0
    speed: float = 1.0
    running: bool = False

    @property
    def start(self) -> float:
        """Of the recording [s]."""
        return 0.0 if self.recording is None else float(self.recording.time[0])

    @property
    def end(self) -> float:
        """Of the recording [s]."""
        return 0.0 if self.recording is None else float(self.recording.time[-1])

    @property
    def frame(self) -> int:
        """The moment that is shown."""
        return 0 if self.recording is None else frame_at(self.recording, self.time)

    def load(self, name: str, recording: Recording | None) -> None:
        """Begin with another recording, or with none; it does not run yet."""
        self.name, self.recording, self.running = name, recording, False
        self.time = self.start

    def seek(self, time: float) -> None:
        """Go to a moment [s]."""
        self.time = min(max(time, self.start), self.end)

    def toggle(self) -> None:
        """Run or hold; from the end it begins again."""
        self.running = self.recording is not None and not self.running
        if self.running and self.time >= self.end:
            self.time = self.start

    def advance(self, seconds: float) -> bool:
        """Go on by as many seconds of the clock where it runs; return whether it did. At the end it holds."""
        if not self.running:
            return False
        self.seek(self.time + self.speed * seconds)
        self.running = self.time < self.end
        return True
