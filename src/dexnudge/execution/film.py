"""An execution as a film: what its trace holds, drawn by the hand's own forward kinematics."""

import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.drive import PHASES, SETTLE
from dexnudge.simulation.episode import Trace
from dexnudge.simulation.push import PushRun
from dexnudge.simulation.push_model import PushModel
from dexnudge.viewer.page import write_recording_page
from dexnudge.viewer.recording import Curve, Recording
from dexnudge.viewer.recording_picture import write_recording_pictures
from dexnudge.viewer.visual_scene import VisualScene, visual_scenes

PAGE_FILE, STRIP_FILE, ANIMATION_FILE = "film.html", "film.png", "film.gif"
FILES = (PAGE_FILE, STRIP_FILE, ANIMATION_FILE)


@dataclass(frozen=True)
class FilmTrace:
    """What a film needs of a trace, see `simulation.records.Records`.

    phase: of each record by name, "" where the trace has none.
    """

    time: Float[np.ndarray, " record"]
    phase: tuple[str, ...]
    qpos: Float[np.ndarray, "record nq"]
    hand_object_force: Float[np.ndarray, "record 2"]
    hand_environment_clearance: Float[np.ndarray, " record"]


def film_trace(run: PushRun | Trace) -> FilmTrace:
    """What a film needs of a push, or of a whole story."""
    names = [PHASES[index] for index in run.phase] if isinstance(run, PushRun) else run.phase.tolist()
    return FilmTrace(run.time, tuple(names), run.qpos, run.hand_object_force, run.hand_environment_clearance)


def read_trace(path: Path) -> FilmTrace:
    """The trace in an npz archive that `write_execution` wrote, or in another one with its arrays.

    Raises:
        InputError: the file cannot be read, lacks an array, or its arrays do not fit together.
    """
    wanted = [name for name in FilmTrace.__dataclass_fields__ if name != "phase"]
    try:
        with path.open("rb") as file, np.lib.npyio.NpzFile(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files if name in FilmTrace.__dataclass_fields__}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{path} cannot be read ({error}); expected the traces that `dexnudge execute` wrote"
        ) from error
    missing = [name for name in wanted if name not in arrays]
    lengths = {len(array) for array in arrays.values()}
    if missing or len(lengths) != 1:
        raise InputError(
            f"{path} has {', '.join(f'{name} {array.shape}' for name, array in arrays.items())}; expected the arrays "
            f"{', '.join(wanted)} and, if phases are named, phase, with one row for each record; execute again"
        )
    phase = tuple(arrays.pop("phase", np.array([""] * lengths.pop())).tolist())
    return FilmTrace(phase=phase, **arrays)


def film_of_trace(scene: Scene, push: PushModel, trace: FilmTrace, *, title: str = "", subtitle: str = "") -> Recording:
    """The film of a run of `push`, with how far the object went and turned since it came to rest at the start.

    The arrow of the motion is shown until the first phase that is none of a push.
    """
    poses = _object_poses(push, trace)
    resting = next((index for index, name in enumerate(trace.phase) if name != PHASES[SETTLE]), 0)
    start = max(resting - 1, 0)
    pushing = next((index for index, name in enumerate(trace.phase) if name and name not in PHASES), len(trace.phase))
    centre = np.append(centre_of_mass(scene.object_mesh), 1.0)
    moved = 1e3 * ((poses - poses[start]) @ centre)[:, :3]
    relative = Rotation.from_matrix(poses[:, :3, :3]) * Rotation.from_matrix(poses[start, :3, :3]).inv()
    charts = {
        "object's way": (Curve("along the motion", "mm", moved @ scene.motion), Curve("upwards", "mm", moved[:, 2])),
        "object's turn": (Curve("since the start", "deg", np.degrees(relative.magnitude())),),
        "hand on object": (
            Curve("normal force", "N", trace.hand_object_force[:, 0]),
            Curve("tangential", "N", trace.hand_object_force[:, 1]),
        ),
        "hand to surroundings": (Curve("clearance", "mm", 1e3 * trace.hand_environment_clearance),),
    }
    frames = [
        _moment(frame, pose, moving=index < pushing)
        for index, (frame, pose) in enumerate(
            zip(visual_scenes(scene, push.hand, push.configurations(trace.qpos)), poses, strict=True)
        )
    ]
    return Recording(frames, trace.time, trace.phase, charts, title, subtitle)


def write_film(film: Recording, folder: Path, *, pictures: bool = True) -> None:
    """Write the page and, unless `pictures` is off, the strip and the animation into a folder, made where it is missing.

    Raises:
        OutputError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_recording_page(film, folder / PAGE_FILE)
    if pictures:
        write_recording_pictures(film, folder / STRIP_FILE, folder / ANIMATION_FILE)


def _moment(frame: VisualScene, T_world_object: Float[np.ndarray, "4 4"], *, moving: bool) -> VisualScene:
    """The object where it is now; the arrow only while it shall move."""
    parts = (replace(part, T_world_part=T_world_object) if part.role == "object" else part for part in frame.parts)
    return replace(frame, parts=tuple(parts), motion=frame.motion if moving else np.zeros(3))


def _object_poses(push: PushModel, trace: FilmTrace) -> Float[np.ndarray, "record 4 4"]:
    free = push.object_position
    poses = np.tile(np.eye(4), (len(trace.qpos), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(trace.qpos[:, free + 3 : free + 7], scalar_first=True).as_matrix()
    poses[:, :3, 3] = trace.qpos[:, free : free + 3]
    return poses
