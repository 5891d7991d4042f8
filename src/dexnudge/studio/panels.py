"""The page: the tabs for draws, for playing and for what is to be seen; that for sampling is `sample_panel`."""

from __future__ import annotations

import io
from functools import partial
from typing import Any

from PIL import Image

from dexnudge.errors import InputError
from dexnudge.studio.controls import Reactions, legend, set_options, set_range, set_values, table
from dexnudge.studio.sample_panel import SamplePanel
from dexnudge.studio.server import Server
from dexnudge.studio.session import Session
from dexnudge.studio.stage import GROUPS, MARKS
from dexnudge.studio.views import PRESSING
from dexnudge.viewer.visual_scene import LEGEND, PALETTE, Colour, tinted

NOTHING = "(nothing)"
HIDDEN = ("friction cones", "supports")  # of the groups, until they are asked for
OPACITIES = {"hand": 1.0, "forearm": 0.35, "surroundings": 0.6}  # at the beginning
PICTURE_TIME = 30.0  # [s] that a browser may take for a picture
SHORTEST = 0.01  # [s] of a slider for time
COLOURS: dict[str, Colour] = {
    "object": PALETTE["object"],
    LEGEND["ghost"]: tinted("ghost"),
    "fingertips": PALETTE["fingertip"],
    "contacts": PALETTE["contact"],
    "motion": PALETTE["arrow"],
    "forces of the hand": PRESSING,
    "forces of the supports": PALETTE["support"],
}
"""Of the legend."""


class Panels:
    """Four tabs, which show what the session is at and tell it what was clicked."""

    def __init__(self, server: Server, session: Session) -> None:
        self._server, self._session = server, session
        self._gui: Any = server.gui  # whose handles' values have no setters, to a type checker
        reactions = Reactions(session, self.refresh)
        self._on = reactions.on
        self._title = self._gui.add_html("")
        self._gui.add_html(legend(COLOURS))
        self._result = self._gui.add_dropdown("result", [NOTHING])
        self._on(self._result, lambda _: self._open())
        self.tabs = self._gui.add_tab_group()
        first = {"Draws": self._draws, "Play": self._play}
        for name in sorted(first, reverse=session.player.recording is not None):  # the page opens on the first tab
            with self.tabs.add_tab(name):
                first[name]()
        with self.tabs.add_tab("Sample"):
            self._sample = SamplePanel(server, reactions)
        with self.tabs.add_tab("View"):
            self._view()
        session.changed = self.refresh
        self.refresh()

    def _open(self) -> None:
        self._session.open(self._result.value)
        self._sample.begin()

    def _draws(self) -> None:
        gui, session = self._gui, self._session
        hint = (
            "best first; rejected ones by their first reason; margins above 1.5 count alike, then decides what presses"
        )
        self._group = gui.add_dropdown("show", [NOTHING], hint=hint)
        self._place = gui.add_slider("draw", min=0, max=1, step=1, initial_value=0)
        self._step = gui.add_button_group("", ["previous", "next"])
        self._together = gui.add_checkbox("all of them together", initial_value=False)
        hint = "links by their distance from the surroundings: red where they touch, yellow at 10 mm"
        self._clearance = gui.add_checkbox("clearance", initial_value=False, hint=hint)
        self._figures = gui.add_html("")
        self._on(self._group, lambda _: session.select(group=self._group.value, place=0))
        self._on(self._place, lambda _: session.select(place=self._place.value))
        self._on(self._step, lambda _: self._go(1 if self._step.value == "next" else -1))
        self._on(self._together, lambda _: session.select(together=self._together.value))
        self._on(self._clearance, lambda _: self._colour())

    def _go(self, by: int) -> None:
        session = self._session
        if (places := session.groups.get(session.group)) is not None:
            session.select(place=(session.place + by) % len(places))

    def _colour(self) -> None:
        self._session.clearance = self._clearance.value
        self._session.show_draws()

    def _play(self) -> None:
        gui, player = self._gui, self._session.player
        self._recording = gui.add_dropdown("play", [NOTHING])
        self._time = gui.add_slider("time [s]", min=0.0, max=1.0, step=SHORTEST, initial_value=0.0)
        self._run = gui.add_button("Play")
        self._speed = gui.add_slider("speed", min=0.1, max=4.0, step=0.1, initial_value=1.0)
        self._moment = gui.add_html("")
        self._on(self._recording, lambda _: self._choose())
        self._on(self._time, lambda _: self._seek())
        self._on(self._run, lambda _: self._toggle())
        self._on(self._speed, lambda _: setattr(player, "speed", self._speed.value))

    def _choose(self) -> None:
        name = self._recording.value
        self._session.play("" if name == NOTHING else name)
        self._session.look()

    def _toggle(self) -> None:
        if self._session.player.recording is None:
            self._choose()
        self._session.player.toggle()

    def _seek(self) -> None:
        time = self._time.value
        if self._session.player.recording is None:
            self._choose()
        self._session.player.running = False
        self._session.player.seek(time)
        self._session.show_moment()

    def _view(self) -> None:
        gui, stage = self._gui, self._session.stage
        for group in dict.fromkeys((*GROUPS, *MARKS)):
            shown = gui.add_checkbox(group, initial_value=group not in HIDDEN)
            stage.hide(group, hidden=group in HIDDEN)
            self._on(shown, partial(self._hide, group))
        for group, opacity in OPACITIES.items():
            fade = gui.add_slider(f"opacity, {group}", min=0.1, max=1.0, step=0.05, initial_value=opacity)
            stage.fade(group, opacity)
            self._on(fade, partial(self._fade, group))
        self._on(gui.add_button("Look from the best side"), lambda _: self._session.look())
        self._on(gui.add_button("Save the picture (PNG)"), self._picture, locked=False)

    def _hide(self, group: str, event: Any) -> None:
        self._session.stage.hide(group, hidden=not event.target.value)

    def _fade(self, group: str, event: Any) -> None:
        self._session.stage.fade(group, event.target.value)

    def _picture(self, event: Any) -> None:
        client = event.client
        size = {"height": client.camera.image_height, "width": client.camera.image_width}
        try:
            picture = Image.fromarray(client.get_render(**size, transport_format="png", timeout=PICTURE_TIME))
        except (TimeoutError, RuntimeError) as error:
            raise InputError(
                f"the browser sent no picture: {error}; expected one; keep the page open, try again"
            ) from error
        white, content = Image.new("RGBA", picture.size, "white"), io.BytesIO()
        Image.alpha_composite(white, picture.convert("RGBA")).convert("RGB").save(content, format="png")
        client.send_file_download(f"{self._session.name}.png", content.getvalue(), save_immediately=True)

    def refresh(self) -> None:
        """Show what the session is at."""
        with self._session.lock, self._server.atomic():
            self._refresh()
            self._sample.refresh()

    def _refresh(self) -> None:
        session, player, groups = self._session, self._session.player, self._session.groups
        set_values(
            self._title, content=table({"shown": f"{session.name} ({session.scene.name})", "hand": session.hand.name})
        )
        set_options(self._result, [*session.results], session.shown)
        set_values(self._result, visible=len(session.results) > 1, disabled=bool(session.busy))
        set_options(self._group, [*groups] or [NOTHING], session.group)
        count = len(groups.get(session.group, ()))
        set_range(self._place, 0, max(1, count - 1), min(session.place, max(count - 1, 0)))
        for handle in (self._group, self._together, self._clearance):
            set_values(handle, disabled=not groups)
        set_values(self._step, visible=bool(groups))  # these cannot be disabled
        set_values(self._place, visible=count > 1, disabled=session.together)
        self._together.value = session.together
        playing, said = player.recording is not None, table(session.figures())
        set_values(self._figures, content="" if playing else said)
        offered, now = [NOTHING, *session.playable], self._recording.value
        if list(self._recording.options) != offered:  # the first is what Play plays, unless another is chosen
            now = offered[min(1, len(offered) - 1)]
        set_options(self._recording, offered, player.name or now)
        offer = player.recording or session.offered(self._recording.value)
        start, end = (0.0, 0.0) if offer is None else (float(offer.time[0]), float(offer.time[-1]))
        set_range(self._time, start, max(end, start + SHORTEST), player.time if playing else start)
        set_values(self._time, disabled=offer is None)
        ended = {"outcome": offer.subtitle} if offer is not None and offer.subtitle else {}
        set_values(self._moment, content=said if playing else table(ended))
        set_values(self._run, disabled=self._recording.value == NOTHING)
        set_values(self._run, label="Pause" if player.running else "Play")
