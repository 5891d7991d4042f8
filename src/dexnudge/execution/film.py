"""An execution as a film: what its trace holds, drawn by the hand's own forward kinematics."""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError, OutputError, check_path
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.hand_path import PHASES, PUSH, SETTLE
from dexnudge.simulation.model import SimulationModel
from dexnudge.simulation.rollout import Trace
from dexnudge.viewer.page import write_recording_page
from dexnudge.viewer.recording import STRIP_PICTURES, Curve, Recording, write_recording_pictures
from dexnudge.viewer.visual_scene import VisualScene, visual_scenes

PAGE_FILE = "film.html"
FILM = Path(PAGE_FILE).stem
LEAST_SHOWN = 0.05  # [N] that a link presses with at some time, to have a curve
FILM_SUFFIXES = (".gif", ".png", ".html")


def film_of_trace(
    scene: Scene,
    simulation: SimulationModel,
    trace: Trace,
    *,
    title: str = "",
    subtitle: str = "",
    success: bool | None = None,
    length: float | None = None,
    push_phases: Sequence[str] = PHASES,
) -> Recording:
    """Return the film of a rollout of `simulation`, with how far the object moved and turned since it came to rest.

    The arrow of the motion is shown until the first phase that is none of `push_phases`. length: of the slide that was asked
    for [m]; the scene's unless given.
    """
    poses, phases = simulation.object_poses(trace.qpos), trace.phase.tolist()
    resting = next((index for index, name in enumerate(phases) if name != SETTLE), 0)
    start = max(resting - 1, 0)
    pushing = next((index for index, name in enumerate(phases) if name not in push_phases), len(phases))
    centre = np.append(centre_of_mass(scene.object_mesh), 1.0)
    moved = 1e3 * ((poses - poses[start]) @ centre)[:, :3]
    turned = Rotation.from_matrix(poses[:, :3, :3]) * Rotation.from_matrix(poses[start, :3, :3]).inv()
    strongest = trace.link_force.max(axis=0)
    links = [link for link in np.argsort(-strongest, kind="stable") if strongest[link] > LEAST_SHOWN]
    charts = {
        "object's way": (Curve("along the motion", "mm", moved @ scene.motion), Curve("upwards", "mm", moved[:, 2])),
        "object's turn": (Curve("since the start", "deg", np.degrees(turned.magnitude())),),
        "hand on object": (
            Curve("normal force", "N", trace.hand_object_force[:, 0]),
            Curve("tangential", "N", trace.hand_object_force[:, 1]),
        ),
        "links on object": (
            *(Curve(simulation.hand.link_names[link], "N", trace.link_force[:, link]) for link in links),
            Curve("limit", "N", np.full(len(trace.time), scene.max_normal_force), limit=True),
        ),
        "hand to surroundings": (Curve("clearance", "mm", 1e3 * trace.hand_environment_clearance),),
    }
    drawn = visual_scenes(scene, simulation.hand, simulation.configurations(trace.qpos))
    frames = [
        with_object_at(frame, pose, moving=index < pushing, length=length)
        for index, (frame, pose) in enumerate(zip(drawn, poses, strict=True))
    ]
    return Recording(frames, trace.time, tuple(phases), charts, title, subtitle, success)


def write_film(
    film: Recording,
    folder: Path,
    *,
    name: str = FILM,
    pictures: bool = True,
    moments: Int[np.ndarray, " chosen"] | None = None,
) -> None:
    """Write the page and, unless `pictures` is off, the strip and the animation into a folder, made where it is missing.

    The files are `name` with .html, .png and .gif; the strip shows `moments`, or those of `told`.

    Raises:
        OutputError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_recording_page(film, folder / f"{name}.html")
    if pictures:
        shown = told(film) if moments is None else moments
        write_recording_pictures(film, folder / f"{name}.png", folder / f"{name}.gif", moments=shown)


def save_film(film: Recording, path: Path | str, *, moments: Int[np.ndarray, " chosen"] | None = None) -> Path:
    """Write a film as an animation (.gif), a strip of pictures (.png), or a 3-D page to play (.html); see `write_film`.

    Raises:
        InputError: another suffix.
        OutputError: the file cannot be written.
    """
    check_path("path", path)
    path = Path(path)
    if path.suffix not in FILM_SUFFIXES:
        raise InputError(f"`path` is {path}; expected a name that ends in {', '.join(FILM_SUFFIXES)}")
    with TemporaryDirectory() as folder:
        written = Path(folder, FILM).with_suffix(path.suffix)
        if path.suffix == ".html":
            write_recording_page(film, written)
        else:
            # Of the animation two pictures are enough where only the strip is wanted.
            some = 2 if path.suffix == ".png" else None
            shown = told(film) if moments is None else moments
            strip, animation = (Path(folder, FILM).with_suffix(suffix) for suffix in (".png", ".gif"))
            write_recording_pictures(film, strip, animation, pictures=some, moments=shown)
        try:
            shutil.copyfile(written, path)
        except OSError as error:
            raise OutputError(
                f"the film {path} cannot be written: {error}; expected a folder that exists, is writable and has free space"
            ) from error
    return path


def told(film: Recording) -> Int[np.ndarray, " chosen"]:
    """Return the moments that tell a film, ascending: of a push approach, contact, way and end; else what is eventful."""
    phases = np.asarray(film.phase)
    pushed = np.flatnonzero(phases == PUSH)
    if not len(pushed) or "lift" in phases:
        return film.eventful(STRIP_PICTURES)
    contact = max(int(pushed[0]) - 1, 0)
    way = contact + film.part(np.arange(contact, pushed[-1] + 1)).eventful(STRIP_PICTURES - 2)
    return np.unique(np.concatenate([[0], way, [len(phases) - 1]]))


def with_object_at(
    frame: VisualScene, T_world_object: Float[np.ndarray, "4 4"], *, moving: bool, length: float | None = None
) -> VisualScene:
    """Return a frame with the object where it is then, and the arrow only while it shall move.

    The arrow leads from the leading edge at the start to where that shall come. length: of the slide [m]; the frame's unless
    given.
    """
    length = frame.motion_length if length is None else length
    parts = (replace(part, T_world_part=T_world_object) if part.role == "object" else part for part in frame.parts)
    return replace(
        frame,
        parts=tuple(parts),
        motion=frame.motion if moving else np.zeros(3),
        motion_length=length,
        arrow_length=length if frame.arrow_length is None else frame.arrow_length,
        arrow_from=frame.with_role("object")[0].T_world_part,
    )
