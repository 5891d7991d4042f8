"""A run moment by moment: where its bodies were, and what was measured."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from dexnudge.errors import InputError
from dexnudge.viewer.camera import Camera, choose_camera, framing_camera
from dexnudge.viewer.visual_scene import VisualScene, check_same_bodies

SAMPLES = 6  # moments that the camera is chosen for
SURROUNDED = 0.25  # [m] from the object's path; of a hand that comes from farther away the rest may leave the picture


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

    Raises:
        InputError: no frames, frames of different bodies, or times, phases or curves of another number.
    """

    frames: Sequence[VisualScene]
    time: Float[np.ndarray, " frame"]
    phase: Sequence[str]
    charts: dict[str, tuple[Curve, ...]]
    title: str = ""
    subtitle: str = ""

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
    """Return one camera for all moments: the best direction for the middle, as near as shows object and robot throughout.

    Args:
        recording: what is seen.
        aspect: width of the picture over its height.
        near: an arm, and a hand that is farther away than 0.25 m, may leave the picture. So may a hand without an arm.
    """
    sampled = recording.part(recording.eventful(SAMPLES)).frames
    best = choose_camera(sampled[len(sampled) // 2], aspect=aspect)
    objects, hands = (
        np.concatenate([frame.vertices(*roles) for frame in sampled]) for roles in (("object",), ("link", "fingertip"))
    )
    low, high = objects.min(axis=0) - SURROUNDED, objects.max(axis=0) + SURROUNDED
    arms = np.concatenate([frame.vertices("arm") for frame in sampled])
    if near or not len(arms):
        arms, hands = arms[:0], hands[((hands >= low) & (hands <= high)).all(axis=1)]
    arrows = [frame.arrow().mesh.vertices.reshape(-1, 3) for frame in sampled]
    framed = np.concatenate([objects, hands, arms, *arrows])
    return framing_camera(framed, azimuth=best.azimuth, elevation=best.elevation, aspect=aspect)
