"""The tab in which a scene is changed and sampled."""

from __future__ import annotations

import re
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dexnudge.energies.terms import BUILTIN_WEIGHTS
from dexnudge.objects.builtin import KINDS
from dexnudge.sampling.methods import find_method
from dexnudge.sampling.sampler import DEFAULT_METHOD
from dexnudge.scenes.families import scene_families
from dexnudge.studio.content import FAMILY, OBJECT, builtin_kind
from dexnudge.studio.controls import Reactions, set_range, set_values, table
from dexnudge.studio.draws import MOST_DRAWS
from dexnudge.studio.edits import Edits, up
from dexnudge.studio.server import Server

QUATERNION_TOLERANCE = 0.1  # on the length of the one that a browser sends, in single precision
GIZMO_SIZE = 0.75  # of the object's longest side
NUMBERS = {
    "motion_length": ("length [mm]", 1e3, 1.0, 300.0),
    "mass": ("mass [g]", 1e3, 1.0, 500.0),
    "friction_hand": ("friction, hand", 1.0, 0.01, 1.5),
    "friction_environment": ("friction, surroundings", 1.0, 0.01, 1.5),
    "max_normal_force": ("greatest force [N]", 1.0, 0.1, 15.0),
}
"""Of the scene's numbers: label, factor, step, and where the slider ends at least."""
ANGLES = {"heading": ("heading [deg]", -180), "turn": ("turn [deg]", -180), "tip": ("tip [deg]", 0)}
"""Of the edits: label and least value."""
FIELDS = {name: label for name, (label, *_) in NUMBERS.items()} | {
    "turn_deg": "turn",
    "tip_deg": "tip",
    "motion": "heading",
    "object_pose": "move the object",
    "num": "draws",
    "out": "save as",
}
"""Of arguments that messages name: the label of the control."""
WEIGHT_RANGE = 4.0  # times its own value, or this


class SamplePanel:
    """Controls for another scene, for the object and its motion, for weights and forces, for drawing and for saving."""

    def __init__(self, server: Server, reactions: Reactions) -> None:
        self._server, self._session = server, reactions.session
        self._gizmo: Any = None
        gui: Any = server.gui
        session = self._session
        with gui.add_folder("Another scene: object, family, seed", expand_by_default=False):
            self._object = gui.add_dropdown("object", list(KINDS), initial_value=OBJECT)
            self._family = gui.add_dropdown("scene", scene_families(), initial_value=FAMILY)
            self._scene_seed = gui.add_number("scene's seed", 0, min=0, step=1)
            self._build = gui.add_button("Build")
        with gui.add_folder("Object and motion"):
            self._move = gui.add_checkbox("move the object", initial_value=False)
            self._angles = {
                name: gui.add_slider(label, min=least, max=180, step=1, initial_value=0)
                for name, (label, least) in ANGLES.items()
            }
            self._numbers = {"motion_length": self._slider(gui, "motion_length")}
            self._reset = gui.add_button("As it was")
        with gui.add_folder("Mass, frictions, force, weights of the energy", expand_by_default=False):
            self._numbers |= {name: self._slider(gui, name) for name in NUMBERS if name != "motion_length"}
            self._own = {name: float(getattr(_method_weights(), name)) for name in BUILTIN_WEIGHTS}
            self._weights = {
                name: gui.add_slider(
                    f"weight, {name}",
                    min=0.0,
                    max=max(WEIGHT_RANGE, WEIGHT_RANGE * own),
                    step=0.1,
                    initial_value=own,
                )
                for name, own in self._own.items()
            }
        self._num = gui.add_number("draws", 32, min=1, max=MOST_DRAWS, step=1)
        self._seed = gui.add_number("seed", 0, min=0, step=1)
        self._start = gui.add_button("Sample", color="teal")
        self._status = gui.add_html("")
        self._stop = gui.add_button("Stop", disabled=True)
        self._suggested = session.suggested
        self._name = gui.add_text("save as", self._suggested)
        self._save = gui.add_button("Save")
        self._suggest()
        self._on = reactions.on
        self._on(self._build, lambda _: self._rebuild())
        self._on(self._move, lambda _: self._toggle_gizmo())
        for name, handle in self._angles.items():
            self._on(handle, partial(self._turned, name))
        for handle in self._numbers.values():
            self._on(handle, lambda _: session.edit(numbers=self._given_numbers()))
        self._on(self._reset, lambda _: self._as_it_was())
        self._on(self._start, lambda _: self._draw())
        self._on(self._stop, lambda _: session.stop(), locked=False)
        self._on(self._save, lambda _: session.save(self._name.value))

    def _slider(self, gui: Any, name: str) -> Any:
        label, factor, step, largest = NUMBERS[name]
        value = factor * float(getattr(self._session.scene, name))
        return gui.add_slider(label, min=0.0, max=max(largest, 2 * value), step=step, initial_value=value)

    def _turned(self, name: str, _: Any) -> None:
        self._session.edit(**{name: float(self._angles[name].value)})

    def _given_numbers(self) -> dict[str, float]:
        """Return the scene's numbers as the sliders say; the scene's own where nobody touched them, to the last digit."""
        own = {name: float(getattr(self._session.scene, name)) for name in NUMBERS}
        given = {name: handle.value / NUMBERS[name][1] for name, handle in self._numbers.items()}
        return {
            name: own[name] if np.isclose(given[name], own[name], rtol=0, atol=1e-9) else given[name] for name in own
        }

    def _rebuild(self) -> None:
        self._session.build(self._object.value, self._family.value, int(self._scene_seed.value))
        self.begin()

    def begin(self) -> None:
        """Follow the session to another scene."""
        self._suggest()
        self._hide_gizmo()

    def _suggest(self) -> None:
        """Offer the scene that is shown as the next to be built."""
        scene = self._session.scene
        if (kind := builtin_kind(scene)) is not None:
            self._object.value = kind
        if scene.name in self._family.options:
            self._family.value = scene.name
            self._scene_seed.value = scene.seed or 0

    def _as_it_was(self) -> None:
        self._session.edit(**vars(Edits.none(self._session.scene)))
        self._toggle_gizmo()

    def _draw(self) -> None:
        weights = {name: slider.value for name, slider in self._weights.items() if slider.value != self._own[name]}
        self._session.sample(num=int(self._num.value), seed=int(self._seed.value), weights=weights)
        self._hide_gizmo()

    def _hide_gizmo(self) -> None:
        self._move.value = False
        self._toggle_gizmo()

    def _toggle_gizmo(self) -> None:
        """Show or hide what the object is dragged by: along its support, and about the support's normal."""
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None
        if not self._move.value:
            return
        self._session.show_scene()
        scene, start = self._session.scene, np.eye(4)
        start[:3, :3] = Rotation.align_vectors([up(scene)], [[0.0, 0.0, 1.0]])[0].as_matrix()
        start[:3, 3] = np.asarray(scene.object_in_world().bounds).mean(axis=0)
        now = self._session.edits.moved @ start
        self._gizmo = self._server.scene.add_transform_controls(
            "/move_the_object",
            scale=GIZMO_SIZE * float(scene.object_mesh.extents.max()),
            active_axes=(True, True, False),
            depth_test=False,
            position=now[:3, 3],
            wxyz=Rotation.from_matrix(now[:3, :3]).as_quat(scalar_first=True),
        )
        self._on(self._gizmo, partial(self._dragged, np.linalg.inv(start)))

    def _dragged(self, T_start_world: Float[np.ndarray, "4 4"], event: Any) -> None:
        length = np.linalg.norm(event.target.wxyz)
        if not (np.isfinite(event.target.position).all() and abs(length - 1.0) < QUATERNION_TOLERANCE):
            return  # no page of ours sends that
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat(event.target.wxyz, scalar_first=True).as_matrix()
        T[:3, 3] = event.target.position
        self._session.drag(T @ T_start_world, ended=event.phase == "end")

    def refresh(self) -> None:
        """Show what the session is at."""
        session = self._session
        if self._suggested != session.suggested:
            self._suggested = self._name.value = session.suggested
        for name, slider in self._angles.items():
            slider.value = int(np.clip(round(getattr(session.edits, name)), slider.min, slider.max))
        for name, slider in self._numbers.items():
            value = NUMBERS[name][1] * session.edits.numbers[name]
            set_range(slider, 0.0, max(slider.max, value), value)
        changing = (self._move, *self._angles.values(), *self._numbers.values(), self._reset)
        for handle in (self._start, self._build, *changing):  # what is being drawn is of the scene as it is
            set_values(handle, disabled=bool(session.busy))
        set_values(self._save, disabled=bool(session.busy) or session.samples is None)
        set_values(self._stop, disabled=not session.busy)
        said = {"now": session.busy, "drawn": "" if session.busy else session.outcome}
        set_values(self._status, content=table({name: text for name, text in said.items() if text}))


def in_fields(message: str) -> str:
    """Return a message with the labels of the page's controls in place of the names of arguments."""
    with_unit = re.sub(r"(`motion_length` to [\d.e-]+)", r"\1 m", message)
    return re.sub(r"`(\w+)`", lambda found: f"*{FIELDS.get(found[1], found[1]).partition(' [')[0]}*", with_unit)


def _method_weights() -> Any:
    return find_method(DEFAULT_METHOD).denoising.weights
