"""What the page is at: the scene with its changes, the draws, what is selected, and what is played."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.errors import DexnudgeError, InputError, check_integer, quote
from dexnudge.jobs.folders import free_folder
from dexnudge.jobs.processes import release_memory
from dexnudge.objects.builtin import builtin_object
from dexnudge.results.folder import count_draws, nothing_verified
from dexnudge.results.samples import Samples
from dexnudge.sampling.methods import find_method
from dexnudge.sampling.sampler import DEFAULT_METHOD, Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.studio.content import Content
from dexnudge.studio.draws import MOST_AT_ONCE, MOST_DRAWS, VERIFIED, draws, figures, listed
from dexnudge.studio.edits import Edits
from dexnudge.studio.playback import Player, carried, forces_at
from dexnudge.studio.stage import ASPECT, Stage
from dexnudge.studio.views import (
    Layers,
    clearance_colours,
    draws_together,
    force_colours,
    layers_of,
    mark,
    scene_alone,
    sliding_parts,
)
from dexnudge.viewer.camera import choose_camera
from dexnudge.viewer.recording import Recording, recording_camera

FOLDER_NAME = re.compile(r"\w[\w.-]{0,99}", re.ASCII)  # that the page may write
MOTION = "the motion, without physics"
MADE_HERE = "built or sampled here"  # beside the folder that was opened


def free_name(out: Path, name: str) -> str:
    """Return the first of `name`, `name-2`, `name-3`, ... that is free in a folder; a number that it has is counted on."""
    return free_folder(out / re.sub(r"-\d+$", "", name)).name


class Session:
    """State of one page, and what follows from each change; nothing here knows a browser.

    Args:
        content: what is there at the beginning.
        stage: shows it.
        out: folder below which `save` writes.
        weights: folder of the model; the shipped one unless given.
        device: see `Sampler`.

    Attributes:
        lock: held while anything changes.
        changed: called after each change.
        tell: shows a title and a message to whoever looks; True for what failed.
        busy: what is done in the background, in words; "" where nothing is.
        outcome: what came of the last sampling, in words; "" before any.
        results: the folder that was opened, and what was built or sampled since, by name.
        shown: name of that which is shown.
        suggested: name of a folder to save into, which is free.
    """

    def __init__(
        self,
        content: Content,
        stage: Stage,
        *,
        out: Path,
        weights: Path | str | None = None,
        device: str = "cpu",
    ) -> None:
        self.lock = threading.RLock()
        self.changed: Callable[[], None] = lambda: None
        self.tell: Callable[[str, str, bool], None] = lambda *_: None
        self.hand, self.clearance = content.hand, False
        self.stage, self.out, self.player, self.busy, self.outcome = stage, out, Player(), "", ""
        self.layers: Layers | None = None
        self._offered: tuple[Callable[[], Recording] | None, Recording | None] = (None, None)
        self._sampler = Sampler(self.hand, weights=weights, device=device)
        self._stopping, self._worker = threading.Event(), threading.Thread()
        self.shown = f"{content.name}, as opened" if content.samples is not None or content.recordings else MADE_HERE
        self.results = {self.shown: content}
        self.open(self.shown)

    def open(self, name: str) -> None:
        """Show one of `results`, with its draws and what can be played."""
        self._check_idle()
        if name not in self.results:
            raise InputError(f"there is no result {quote(name)}; expected one of those that are listed")
        content = self.results[name]
        self.shown, self.name, self.scene = name, content.name, content.scene
        self.samples, self.files = content.samples, content.recordings
        self.edits, self.outcome = Edits.none(self.scene), ""
        self.group, self.place, self.together = "", 0, False
        self._offered = (None, None)
        self.suggested = free_name(self.out, f"{self.name}-studio")
        if self.samples is not None:
            self.select(group=next(iter(self.groups)))
        if content.played:
            self.play(next(iter(self.files)))
        elif self.samples is None:
            self.show_scene()
        self.look()

    @property
    def groups(self) -> dict[str, np.ndarray]:
        """Places of the draws by group, see `listed`; empty without draws."""
        return {} if self.samples is None else listed(self.samples)

    @property
    def selected(self) -> int | None:
        """Place of the draw that is selected; None without any."""
        places = self.groups.get(self.group)
        return None if places is None else int(places[min(self.place, len(places) - 1)])

    @property
    def playable(self) -> list[str]:
        """Names of what can be played."""
        return [*self.files, *([MOTION] if self.samples is not None else [])]

    def select(self, *, group: str | None = None, place: int | None = None, together: bool | None = None) -> None:
        """Show a draw by its place in a group, or the first draws of the group together."""
        self.group = self.group if group is None else group
        self.place = self.place if place is None else place
        self.together = self.together if together is None else together
        self.show_draws()

    def show_draws(self) -> None:
        """Show what is selected, or the scene where there are no draws."""
        index = self.selected
        if self.samples is None or index is None:
            self.show_scene()
            return
        self.player.load("", None)
        places = self.groups[self.group][:MOST_AT_ONCE] if self.together else np.array([index])
        views, colours = draws_together(self.samples, places), None
        self.layers = None if self.together else layers_of(self.samples[index])
        if self.layers is not None and self.clearance:
            colours = [clearance_colours(views[0], self.layers, self.hand.link_names)]
        with self.stage.atomic():
            self.stage.show(views, extra=sliding_parts(self.samples.scene), colours=colours)
            mark(self.stage, self.layers)
        self.changed()

    def show_scene(self) -> None:
        """Show the scene with its changes, without a hand."""
        self.player.load("", None)
        self.layers, scene = None, self.edits.preview(self.scene)
        with self.stage.atomic():
            mark(self.stage, None)
            self.stage.show([scene_alone(scene)], extra=sliding_parts(scene))
        self.changed()

    def figures(self) -> dict[str, str]:
        """Return what is said of what is shown, by name."""
        if (recording := self.player.recording) is not None:
            forces = forces_at(recording, self.player.frame)
            pressing = {name: f"{force:.2f} N" for name, force in forces.items() if force > 0}
            ended = {"outcome": recording.subtitle} if recording.subtitle else {}
            return {"moment": recording.caption(self.player.frame), **ended, **pressing}
        index = self.selected
        if self.samples is None or index is None:
            return {}
        if self.layers is None:
            return {"drawn": str(len(self.samples)), "verified": str(self.samples.num_verified)}
        sample = self.samples[index]
        return figures(sample, index, self.layers, sentence=self.samples.verdicts.sentences.get(sample.reason, ""))

    def build(self, name: str, family: str, seed: int) -> None:
        """Begin anew with a built-in object in a scene of a family."""
        self._check_idle()
        scene = build_scene(family, builtin_object(name), seed=seed)
        self.results[MADE_HERE] = Content(f"{name}-{family}", scene, self.hand)
        self.open(MADE_HERE)
        release_memory()  # of the scene before

    def edit(self, **changes: Any) -> None:
        """Change the scene, see `Edits`; draws of before stay until others are drawn."""
        self._check_idle()
        edits = Edits(**{**vars(self.edits), **changes})
        edits.preview(self.scene)  # what is out of its domain changes nothing
        self.edits = edits
        self.show_scene()

    def drag(self, moved: Float[np.ndarray, "4 4"], *, ended: bool) -> None:
        """Move the object; what follows from it is shown when the drag has ended."""
        self._check_idle()
        if ended:
            self.edit(moved=moved)
        else:
            self.stage.move_object(moved @ self.scene.T_world_object)

    def offered(self, name: str) -> Recording | None:
        """Return an episode or a plan by its name before it is played; None where it cannot be, as playing it says."""
        if name not in self.files:
            return None
        if self._offered[0] is not self.files[name]:
            try:
                recording = self.files[name]()
            except InputError:
                recording = None
            self._offered = (self.files[name], recording)
        return self._offered[1]

    def play(self, name: str) -> None:
        """Show the first moment of an episode or a plan by its name; "" goes back to the draws."""
        if not name:
            self.show_draws()
            return
        if name == MOTION:
            index = self.selected
            if self.samples is None or index is None:
                raise InputError("there is no draw whose motion could be shown; sample first")
            self.player.load(name, carried(self.samples[index]))
        elif name not in self.files:
            raise InputError(f"there is no {quote(name)} to play any more; expected one of those that are listed")
        else:
            self.player.load(name, self.offered(name) or self.files[name]())
        self.layers = None
        mark(self.stage, None)
        self.show_moment()

    def show_moment(self) -> None:
        """Show the moment that the player is at."""
        recording = self.player.recording
        if recording is None:
            return
        frame, limit = self.player.frame, self.scene.max_normal_force
        view = recording.frames[frame]
        parts = sliding_parts(self.samples.scene if self.samples is not None else self.scene)
        extra = [part for part in parts if part.role == "ghost"]  # an arrow that stays would stick out of what moves
        self.stage.show([view], extra=extra, colours=[force_colours(view, forces_at(recording, frame), limit)])
        self.changed()

    def tick(self, seconds: float) -> None:
        """Go on with what is played."""
        if self.player.advance(seconds):
            self.show_moment()

    def look(self) -> None:
        """Look at what is shown from its best side."""
        if (recording := self.player.recording) is not None:
            camera, view = recording_camera(recording, aspect=ASPECT), recording.frames[0]
        elif self.samples is not None and (index := self.selected) is not None:
            view = draws_together(self.samples, np.array([index]))[0]
            camera = choose_camera(view, aspect=ASPECT)
        else:
            view = scene_alone(self.scene)
            camera = choose_camera(view, aspect=ASPECT)
        self.stage.look(camera, view.vertices("object").mean(axis=0))

    def sample(self, *, num: int, seed: int, weights: Mapping[str, float]) -> None:
        """Draw in the background; verified hands appear as they come.

        weights: of the energy's terms, where they should differ from the method's own.
        """
        self._check_idle()
        check_integer("num", num, least=1, most=MOST_DRAWS)
        method = find_method(DEFAULT_METHOD).with_weights(weights)
        edits, scene, self.outcome = self.edits, self.scene, ""
        if self.player.recording is not None:  # an arm is looked at from afar
            self.show_scene()
            self.look()

        def run() -> None:
            for samples in draws(self._sampler, edits.applied(scene), num=num, seed=seed, method=method):
                with self.lock:
                    if self._stopping.is_set():
                        return
                    self.busy = f"drawn {len(samples)} of {num}, verified {samples.num_verified}"
                    self._take(samples)
                    self.outcome = f"{samples.num_verified} of {len(samples)} verified"
            with self.lock:
                found = self.samples
            if found is not None and not found.num_verified:
                counts = count_draws(found.verdicts) | {"reasons": found.verdicts.sentences}
                self.tell("Nothing is verified", nothing_verified(counts), True)

        self._begin("preparing the scene", run)

    def _take(self, samples: Samples) -> None:
        self.samples, self.files, self.shown = samples, {}, MADE_HERE
        self.results[MADE_HERE] = Content(self.name, samples.scene, self.hand, samples)
        names = list(self.groups)
        verified = [name for name in names if name.startswith(f"{VERIFIED} (")]
        self.select(group=(verified or names)[0], place=0, together=False)

    def save(self, name: str) -> None:
        """Write a result folder below `out` in the background, as `dexnudge sample` does.

        Raises:
            InputError: no draws, or a name that leads elsewhere.
        """
        self._check_idle()
        samples = self.samples
        if samples is None:
            raise InputError("there are no draws to save; expected some; sample first")
        if not FOLDER_NAME.fullmatch(name):
            raise InputError(
                f"the name {quote(name)} is no folder's; expected letters, digits, points, - and _; change *save as*"
            )

        def run() -> None:
            if os.path.lexists(self.out / name):
                raise InputError(f"there is a folder {quote(name)} already; expected a new one; change *save as*")
            samples.save(self.out / name, title=self.name)
            self.suggested = free_name(self.out, name)
            self.tell("Saved", f"{name}; dexnudge check {name} recomputes its figures", False)

        self._begin(f"saving {name}", run)

    def stop(self) -> None:
        """End what is done in the background as soon as the draws that are under way are there."""
        self._stopping.set()

    def wait(self, timeout: float | None = None) -> None:
        """Wait until nothing is done in the background [s]."""
        if self.working:
            self._worker.join(timeout)

    @property
    def working(self) -> bool:
        """Whether something is done in the background."""
        return self._worker.is_alive()

    @contextmanager
    def telling(self) -> Iterator[None]:
        """Show what the block refuses, and that there is a bug where it fails otherwise."""
        try:
            yield
        except DexnudgeError as error:
            self.tell("Not possible", str(error), True)
        except Exception:
            self.tell("A bug", "something failed inside; the terminal says what", True)
            raise

    def _check_idle(self) -> None:
        if self.busy:
            raise InputError(f"the studio is busy: {self.busy}; expected nothing under way; stop it, or wait")

    def _begin(self, what: str, task: Callable[[], None]) -> None:
        def run() -> None:
            try:
                with self.telling():
                    task()
            finally:
                with self.lock:
                    self.busy = ""
                    self.changed()

        self._stopping.clear()
        self.busy = what
        self._worker = threading.Thread(target=run, name="dexnudge-studio", daemon=True)
        self._worker.start()
        self.changed()
