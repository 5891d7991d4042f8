"""A run moment by moment: where its bodies were, what was measured, and its pictures: a strip and an animation."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int, UInt8
from PIL import Image

from dexnudge.errors import InputError, writing
from dexnudge.viewer.camera import Camera, best_camera, hiding_faces
from dexnudge.viewer.picture import BAD, GOOD, NEUTRAL, arrange, headed, render_array, write_png
from dexnudge.viewer.visual_scene import ROBOT, SEE_THROUGH, Role, VisualScene, check_same_bodies

JUDGED = 4  # moments by which the camera is chosen
LOOKED_THROUGH = 12  # moments looked at: what hides object or hand is glass from the first to the last, without flicker
SURROUNDED = 0.25  # [m] from the object's path; in pictures from near the hand may be farther away


@dataclass(frozen=True)
class Curve:
    """One quantity: a number for each moment, NaN where there is none, in `unit`; measured, or a `limit` on the others."""

    name: str
    unit: str
    values: Float[np.ndarray, " frame"]
    limit: bool = False


@dataclass(frozen=True, eq=False)
class Recording:
    """Moments of one run, in order.

    Attributes:
        frames: of the same bodies in the same order, as `visual_scenes` returns them; a motion of zero has no arrow.
        time: of each [s], ascending.
        phase: name of each, such as "push"; "" where it has none.
        charts: curves by the title of the chart that shows them together.
        title: plain text.
        subtitle: plain text, such as what came of it.
            The strip says it above its pictures.
        success: whether that is good, and stands there in green, or in red; None for neither.

    Raises:
        InputError: no frames, frames of different bodies, or times, phases or curves of another number.
    """

    frames: Sequence[VisualScene]
    time: Float[np.ndarray, " frame"]
    phase: Sequence[str]
    charts: dict[str, tuple[Curve, ...]]
    title: str = ""
    subtitle: str = ""
    success: bool | None = None

    def __post_init__(self) -> None:
        check_same_bodies(self.frames)
        lengths = {"time": len(self.time), "phase": len(self.phase)}
        lengths |= {curve.name: len(curve.values) for curves in self.charts.values() for curve in curves}
        for name, length in lengths.items():
            if length != len(self.frames) or length == 0:
                raise InputError(
                    f"a recording of {len(self.frames)} frames has {length} entries of {name}; expected one for each frame, "
                    "and at least one frame"
                )

    def part(self, indices: Int[np.ndarray, " chosen"]) -> "Recording":
        """Return some of the moments."""
        picked = indices.tolist()
        return replace(
            self,
            frames=[self.frames[index] for index in picked],
            time=self.time[indices],
            phase=[self.phase[index] for index in picked],
            charts={
                title: tuple(replace(curve, values=curve.values[indices]) for curve in curves)
                for title, curves in self.charts.items()
            },
        )

    def caption(self, index: int) -> str:
        """Return time and phase of a moment."""
        return f"{self.time[index]:.2f} s  {self.phase[index]}".rstrip()

    def evenly(self, count: int) -> Int[np.ndarray, " chosen"]:
        """Return up to `count` moments, evenly spaced in time, the first and the last among them; ascending, each once."""
        wanted = np.linspace(self.time[0], self.time[-1], count)
        return np.unique(np.abs(self.time[:, None] - wanted).argmin(axis=0))

    def eventful(self, count: int) -> Int[np.ndarray, " chosen"]:
        """Return up to `count` moments between which about equally much moves, the first and the last among them.

        What moves: the object's origin and the first link's, each as a share of its whole way.
        """
        travelled = np.zeros(len(self.frames))
        for roles in (("object",), ("link", "fingertip")):
            origins = np.stack([frame.with_role(*roles)[0].T_world_part[:3, 3] for frame in self.frames])
            way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(origins, axis=0), axis=1)))
            travelled += way / max(way[-1], 1e-9)
        wanted = np.linspace(0.0, travelled[-1], count)
        wanted[-1] = np.inf
        found = np.searchsorted(travelled, wanted)
        return np.unique(np.minimum(found, len(self.frames) - 1))


def recording_camera(recording: Recording, *, aspect: float, near: bool = False) -> Camera:
    """Return one camera for all moments, as near as shows object, robot and goal throughout.

    Args:
        recording: what is seen.
        aspect: width of the picture over its height.
        near: an arm, and a hand that is farther away than 0.25 m, may leave the picture.
    """
    objects = np.concatenate([_corners(frame, "object") for frame in recording.frames])
    robots = np.concatenate([_corners(frame, "link", "fingertip", "arm") for frame in recording.frames])
    if near:
        hands = np.concatenate([_corners(frame, "link", "fingertip") for frame in recording.frames])
        low, high = objects.min(axis=0) - SURROUNDED, objects.max(axis=0) + SURROUNDED
        robots = hands[((hands >= low) & (hands <= high)).all(axis=1)]
    first = recording.frames[0]
    goal = _corners(first, "object") + first.motion * first.motion_length
    judged = recording.part(recording.eventful(JUDGED)).frames
    arrows = [frame.arrow().mesh.vertices.reshape(-1, 3) for frame in judged]
    framed = np.concatenate([objects, robots, goal, _corners(first, "ghost", "arrow"), *arrows])
    return best_camera(judged, framed, aspect=aspect)


def _corners(frame: VisualScene, *roles: Role) -> Float[np.ndarray, "n 3"]:
    """Return the corners of the boxes around parts, each along the axes of its part [m], world frame."""
    boxes = [
        trimesh.transform_points(trimesh.bounds.corners(part.mesh.bounds), part.T_world_part)
        for part in frame.with_role(*roles)
    ]
    return np.concatenate([np.zeros((0, 3)), *boxes])


TILE = (960, 640)  # pixels of each picture of the animation, width and height
STRIP_SCALE = 2  # by which those of the strip are smaller
STRIP_PICTURES = 6
VERDICT_COLOURS = {True: GOOD, False: BAD, None: NEUTRAL}
STRIP_COLUMNS = 3  # below a verdict, so that it can be read where the strip is as wide as a screen
PICTURES_PER_SECOND = 10.0  # of the animation, as far as that makes no more than
MOST_PICTURES = 40
LIGHT_EVERY = 4  # pixels: shadows of an animation need no more
PICTURE_TIME = (0.06, 0.2)  # [s] that the animation shows each picture: a long recording runs faster than it was
LAST_PICTURE_TIME = 1.5  # [s] that it shows the last one, before it begins again
COLOURS = 255  # of an animation's pictures together; one more is left for what did not change
LARGEST_FILE = 8_000_000  # bytes of an animation; a larger one gets fewer colours
PALETTE_PICTURES = 4  # of which the colours are taken
COARSE = 8  # levels of a channel that count as one kind of colour

Picture = UInt8[np.ndarray, "height width 3"]


def write_recording_pictures(
    recording: Recording,
    strip: Path | str,
    animation: Path | str,
    *,
    pictures: int | None = None,
    moments: Int[np.ndarray, " chosen"] | None = None,
    tile: tuple[int, int] | None = None,
) -> None:
    """Write the strip (PNG) and the animation (GIF); every picture says its time and phase.

    Args:
        recording: what is shown.
        strip: up to six of the animation's moments, between which about equally much moves, unless `moments` are given.
            Where there is an arm, a second row shows hand and object from near. Its pictures are half as large; below what
            came of it they stand in rows of three.
        animation: evenly spaced moments, in real time where the recording is not too long for that; at most 8 MB.
        pictures: of the animation, at most as many as the recording has moments; ten a second, up to 40, unless given.
        moments: of the recording, which the strip shows.
        tile: width and height of a picture of the animation in pixels; 960 x 640 unless given.

    Raises:
        InputError: fewer than two pictures.
        OutputError: a file cannot be written.
    """
    if pictures is not None and pictures < 2:
        raise InputError(f"an animation of {pictures} pictures was asked for; expected at least 2")
    tile = tile or TILE
    length = float(recording.time[-1] - recording.time[0])
    animated = recording.evenly(pictures or int(np.clip(round(PICTURES_PER_SECOND * length), 2, MOST_PICTURES)))
    if moments is None:
        wanted = recording.time[recording.eventful(STRIP_PICTURES)]
        moments = animated[np.unique(np.abs(recording.time[animated][:, None] - wanted).argmin(axis=0))]
    drawn = _draw(recording, np.union1d(animated, moments), tile)
    captions = {index: recording.caption(index) for index in drawn}
    small = (tile[0] // STRIP_SCALE, tile[1] // STRIP_SCALE)
    near = _draw(recording, moments, tile, near=True) if recording.frames[0].with_role("arm") else {}
    columns = len(moments) if recording.success is None else STRIP_COLUMNS
    rows, titles = list[Picture](), list[str]()
    for start in range(0, len(moments), columns):
        row = moments[start : start + columns].tolist()
        rows += [pictures_of[index] for pictures_of in (drawn, near) if pictures_of for index in row]
        titles += [captions[index] for index in row] + [""] * len(row) * bool(near)
    rows = [np.asarray(Image.fromarray(picture).resize(small, Image.Resampling.LANCZOS)) for picture in rows]
    sheet = arrange(rows, titles, columns=columns)
    if recording.subtitle:
        sheet = headed(sheet, recording.subtitle, VERDICT_COLOURS[recording.success])
    write_png(sheet, strip)
    shown_for = float(np.clip(length / max(len(animated) - 1, 1), *PICTURE_TIME))
    titled = [arrange([drawn[index]], [captions[index]], columns=1) for index in animated.tolist()]
    with writing(f"the animation {animation}"):
        Path(animation).write_bytes(_gif(titled, shown_for))


def _draw(
    recording: Recording, moments: Int[np.ndarray, " chosen"], tile: tuple[int, int], *, near: bool = False
) -> dict[int, Picture]:
    """Return pictures of some moments by one camera."""
    camera = recording_camera(recording, aspect=tile[0] / tile[1], near=near)
    looked_at = recording.eventful(LOOKED_THROUGH)
    hiding = [hiding_faces(recording.frames[index], camera) for index in looked_at.tolist()]
    for number, part in enumerate(recording.frames[0].with_role(*SEE_THROUGH)):
        if part.role in ROBOT:  # which look the same throughout
            once = np.any([hides[number] for hides in hiding], axis=0)
            for hides in hiding:
                hides[number] = once
    return {
        index: render_array(
            recording.frames[index],
            size=tile,
            camera=camera,
            glass=glass_at(index, looked_at, hiding),
            light_every=LIGHT_EVERY,
        )
        for index in moments.tolist()
    }


def glass_at(
    index: int, looked_at: Int[np.ndarray, " moment"], hiding: Sequence[Sequence[Bool[np.ndarray, "_"]]]
) -> list[Bool[np.ndarray, "_"]]:
    """Return which triangles of each part are glass at a moment: from the first to the last time that they hide something.

    looked_at: moments, ascending. hiding: of each of them, as `hiding_faces` returns it.
    """
    after = int(np.searchsorted(looked_at, index, side="right"))
    before = max(after - 1, 0)
    return [np.any(part[: after + 1], axis=0) & np.any(part[before:], axis=0) for part in zip(*hiding, strict=True)]


def _gif(pictures: list[Picture], shown_for: float) -> bytes:
    """Return an animation that shows each picture for so long [s], the last one longer."""
    some = [pictures[index] for index in np.linspace(0, len(pictures) - 1, PALETTE_PICTURES).astype(int)]
    pixels = np.concatenate(some).reshape(-1, 3)
    # Half by area and half by kind, so that an arrow far away keeps its green.
    kinds = np.unique(pixels[np.unique(_one_number(pixels // COARSE), return_index=True)[1]], axis=0)
    shared = Image.fromarray(np.concatenate([pixels, np.resize(kinds, pixels.shape)])[None])
    durations = [round(1e3 * shown_for)] * (len(pictures) - 1) + [round(1e3 * LAST_PICTURE_TIME)]
    colours, written = COLOURS, io.BytesIO()
    while colours == COLOURS or (written.tell() > LARGEST_FILE and colours > 1):
        palette, written = shared.quantize(colours, method=Image.Quantize.MEDIANCUT), io.BytesIO()
        frames = [Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
        frames[0].save(written, format="GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0)
        colours //= 2
    return written.getvalue()


def _one_number(colours: UInt8[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Return 24 bits for each colour, in the order of red, then green, then blue: rows take ten times as long to sort."""
    return colours.astype(np.int32) @ np.array([1 << 16, 1 << 8, 1], dtype=np.int32)
