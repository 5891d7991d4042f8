"""A recording as pictures, without GPU or display: a strip of moments side by side, and an animation."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int, UInt8
from PIL import Image

from dexnudge.errors import InputError, writing
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
COARSE = 8  # levels of a channel that count as one kind of colour


def write_recording_pictures(
    recording: Recording,
    strip: Path | str,
    animation: Path | str,
    *,
    pictures: int | None = None,
    moments: Int[np.ndarray, " chosen"] | None = None,
    tile: tuple[int, int] = TILE,
) -> None:
    """Write the strip (PNG) and the animation (GIF); every picture says its time and phase.

    Args:
        recording: what is shown.
        strip: up to six of the animation's moments, between which about equally much moves, unless `moments` are given.
            Where there is an arm, a second row shows hand and object from near.
        animation: evenly spaced moments, in real time where the recording is not too long for that.
        pictures: of the animation, at most as many as the recording has moments; ten a second, up to 60, unless given.
        moments: of the recording, which the strip shows.
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
    if moments is None:
        wanted = recording.time[recording.eventful(STRIP_PICTURES)]
        moments = animated[np.unique(np.abs(recording.time[animated][:, None] - wanted).argmin(axis=0))]
    drawn = {
        index: render_array(recording.frames[index], size=tile, camera=camera, glass=glass)
        for index in np.union1d(animated, moments).tolist()
    }
    captions = {index: recording.caption(index) for index in drawn}
    rows, titles = [drawn[index] for index in moments.tolist()], [captions[index] for index in moments.tolist()]
    if recording.frames[0].with_role("arm"):
        rows += _from_near(recording, moments, tile)
        titles += [""] * len(moments)
    write_png(arrange(rows, titles, columns=len(moments)), strip)
    shown_for = float(np.clip(length / max(len(animated) - 1, 1), *PICTURE_TIME))
    _write_gif(
        [arrange([drawn[index]], [captions[index]], columns=1) for index in animated.tolist()], shown_for, animation
    )


def _from_near(
    recording: Recording, moments: Int[np.ndarray, " chosen"], tile: tuple[int, int]
) -> list[UInt8[np.ndarray, "height width 3"]]:
    """Return pictures of hand and object alone."""
    aspect = tile[0] / tile[1]
    camera = recording_camera(recording, aspect=aspect, near=True)
    glass = _glass(recording, camera, aspect)
    return [render_array(recording.frames[index], size=tile, camera=camera, glass=glass) for index in moments.tolist()]


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
    pixels = np.concatenate(some).reshape(-1, 3)
    # Half by area and half by kind, so that an arrow far away keeps its green.
    kinds = np.unique(pixels[np.unique(pixels // COARSE, axis=0, return_index=True)[1]], axis=0)
    shared = np.concatenate([pixels, np.resize(kinds, pixels.shape)])
    palette = Image.fromarray(shared[None]).quantize(COLOURS, method=Image.Quantize.MEDIANCUT)
    frames = [Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    durations = [round(1e3 * shown_for)] * (len(frames) - 1) + [round(1e3 * LAST_PICTURE_TIME)]
    with writing(f"the animation {path}"):
        frames[0].save(path, format="GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0)
