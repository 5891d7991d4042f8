"""A recording as pictures, without GPU or display: a strip of moments side by side, and an animation."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image

from dexnudge.errors import InputError, OutputError
from dexnudge.viewer.camera import Camera, hiding_faces
from dexnudge.viewer.picture import arrange, render_array, write_png
from dexnudge.viewer.recording import SAMPLES, Recording, recording_camera
from dexnudge.viewer.visual_scene import SURROUNDINGS

TILE = (400, 300)  # pixels of each picture, width and height
STRIP_PICTURES = 6
PICTURES_PER_SECOND = 10.0  # of the animation, as far as that makes no more than
MOST_PICTURES = 60
PICTURE_TIME = (0.06, 0.2)  # [s] that the animation shows each picture: a long recording runs faster than it was
LAST_PICTURE_TIME = 1.5  # [s] that it shows the last one, before it begins again
COLOURS = 255  # of an animation's pictures together; one more is left for what did not change
PALETTE_PICTURES = 4  # of which the colours are taken


def write_recording_pictures(
    recording: Recording,
    strip: Path | str,
    animation: Path | str,
    *,
    pictures: int | None = None,
    tile: tuple[int, int] = TILE,
) -> None:
    """Write the strip (PNG) and the animation (GIF); every picture says its time and phase.

    Args:
        recording: what is shown.
        strip: up to six of the animation's moments, between which about equally much moves.
        animation: evenly spaced moments, in real time where the recording is not too long for that.
        pictures: of the animation, at most as many as the recording has moments; ten a second, up to 60, unless given.
        tile: width and height of a picture in pixels.

    Raises:
        InputError: fewer than two pictures.
        OutputError: a file cannot be written.
    """
    if pictures is not None and pictures < 2:
        raise InputError(f"an animation of {pictures} pictures was asked for; expected at least 2")
    aspect = tile[0] / tile[1]
    camera = recording_camera(recording, aspect=aspect)
    glass = _glass(recording, camera, aspect)
    length = float(recording.time[-1] - recording.time[0])
    animated = recording.evenly(pictures or int(np.clip(round(PICTURES_PER_SECOND * length), 2, MOST_PICTURES)))
    wanted = recording.time[recording.eventful(STRIP_PICTURES)]
    chosen = animated[np.unique(np.abs(recording.time[animated][:, None] - wanted).argmin(axis=0))].tolist()
    drawn = {
        index: render_array(recording.frames[index], size=tile, camera=camera, glass=glass)
        for index in animated.tolist()
    }
    captions = {index: recording.caption(index) for index in drawn}
    sheet = arrange([drawn[index] for index in chosen], [captions[index] for index in chosen], columns=len(chosen))
    write_png(sheet, strip)
    shown_for = float(np.clip(length / max(len(drawn) - 1, 1), *PICTURE_TIME))
    _write_gif([arrange([drawn[index]], [captions[index]], columns=1) for index in drawn], shown_for, animation)


def _glass(recording: Recording, camera: Camera, aspect: float) -> list[Bool[np.ndarray, " face"]]:
    """Return which triangles of each part of the surroundings hide something at some moment: so none flickers."""
    sampled = recording.part(recording.eventful(SAMPLES)).frames
    hiding = [
        [hiding_faces(part.mesh_in_world(), frame, camera, aspect=aspect) for part in frame.with_role(*SURROUNDINGS)]
        for frame in sampled
    ]
    return [np.any(moments, axis=0) for moments in zip(*hiding, strict=True)]


def _write_gif(pictures: list[UInt8[np.ndarray, "height width 3"]], shown_for: float, path: Path | str) -> None:
    """Each picture is shown for so long [s], the last one longer."""
    some = [pictures[index] for index in np.linspace(0, len(pictures) - 1, PALETTE_PICTURES).astype(int)]
    palette = Image.fromarray(np.concatenate(some)).quantize(COLOURS, method=Image.Quantize.MEDIANCUT)
    frames = [Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    durations = [round(1e3 * shown_for)] * (len(frames) - 1) + [round(1e3 * LAST_PICTURE_TIME)]
    try:
        frames[0].save(path, format="GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0)
    except OSError as error:
        raise OutputError(
            f"the animation {path} cannot be written: {error}; expected a folder that exists and is writable"
        ) from error
