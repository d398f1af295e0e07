"""The controls of one window: the timeline, and the display choices."""

import dataclasses
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..contents import Contents
from ..figures.depth_layers import LAYER_COLOURS
from ..figures.eye import FRONT, SIDE, TOP
from ..figures.scan_colours import heat_legend
from .column import DISTANCE, PLAIN, POSTERIOR, Choice
from .text import as_markdown
from .timeline import SPEEDS, Timeline

if TYPE_CHECKING:
    from viser import GuiApi
    from viser._messages import HotkeyKey
else:
    GuiApi = HotkeyKey = Any

#: slider updates a second; drawing one costs the browser more than a frame does
SLIDER_RATE = 8.0
PLAY, PAUSE = "Play", "Pause"
BACK, NEXT = "Back", "Next"
HELP = "Click a body or a bone to identify it."


class Controls:
    """The controls of one browser. `changed` is called after each change of `timeline` or `choice`; `set_view`
    takes the name of a direction to look from."""

    def __init__(
        self,
        gui: GuiApi,
        contents: Contents,
        spacing: float | None,
        changed: Callable[[], None],
        set_view: Callable[[str], None],
    ):
        self.timeline = Timeline(contents.frames, contents.rate)
        self.choice = Choice()
        #: metres between takes: None for automatic by their widths, 0 to overlay them
        self.spacing = self._initial_spacing = spacing
        #: whether a growing run is shown at its newest frame
        self.follows_newest = any(take.run_folder is not None for take in contents.takes)
        self._changed, self._drawn = changed, 0.0
        with gui.add_folder("Time"):
            self._frame = gui.add_slider(
                "Frame", min=0, max=max(self.timeline.frames - 1, 1), step=1, initial_value=0,
                disabled=self.timeline.frames < 2 and not self.follows_newest,
            )  # fmt: skip
            self._play = gui.add_button(PLAY, disabled=self._frame.disabled, hint="key P")
            steps = gui.add_button_group(
                "Step", (BACK, NEXT), visible=not self._frame.disabled, hint="one frame: keys B and N"
            )
            self._speed = gui.add_dropdown(
                "Speed", tuple(f"{speed:g} x" for speed in SPEEDS), initial_value="1 x"
            )
            self._time = gui.add_text("Time", "", disabled=True)
            follow = gui.add_checkbox("Newest frame", self.follows_newest, visible=self.follows_newest)
        views = gui.add_button_group("Look from", (FRONT, SIDE, TOP), hint="keys 1, 2 and 3")
        with gui.add_folder("Show"):
            self._add_switches(gui, contents)
        self._clicked = gui.add_markdown(HELP)
        self._told = "\n\n".join(map(as_markdown, contents.notes))
        self._note = gui.add_markdown(self._told, visible=bool(contents.notes))
        # these are called for values set by the program, too; only a browser's event has a client
        self._frame.on_update(lambda event: self._seek(int(event.target.value), event.client is not None))
        self._play.on_click(lambda event: self._toggle_play())
        self._speed.on_update(lambda event: self._set_speed(float(event.target.value.split()[0])))
        follow.on_update(lambda event: self._follow(event.target.value))
        self._steps = steps
        steps.on_click(lambda event: self._step(1 if event.target.value == NEXT else -1))
        views.on_click(lambda event: set_view(event.target.value))
        # the slider and the camera use the arrow keys
        keys: tuple[tuple[str, HotkeyKey, Callable[[], None]], ...] = (
            ("Play or pause", "P", self._toggle_play),
            ("One frame back", "B", lambda: self._step(-1)),
            ("One frame forward", "N", lambda: self._step(1)),
            ("Look from the front", "1", lambda: set_view(FRONT)),
            ("Look from the side", "2", lambda: set_view(SIDE)),
            ("Look from the top", "3", lambda: set_view(TOP)),
        )
        for label, key, act in keys:
            gui.add_command(label, hotkey=key).on_trigger(lambda event, act=act: act())

    def show_description(self, text: str) -> None:
        """Show the description of the clicked object."""
        self._clicked.content = as_markdown(text)

    def draw(self, frame: int, note: str) -> None:
        """Show the current frame number, and an error message."""
        now, timeline = time.monotonic(), self.timeline
        text = "\n\n".join(filter(None, (as_markdown(note), self._told)))
        if text != self._note.content:
            self._note.content, self._note.visible = text, bool(text)
        if timeline.playing and now - self._drawn < 1.0 / SLIDER_RATE:
            return
        self._drawn = now
        self._frame.value = frame
        self._time.value = f"{frame / timeline.rate:.2f} of {(timeline.frames - 1) / timeline.rate:.2f} s"

    def grow(self, frames: int) -> None:
        """Set the number of frames; show the newest one if the user chose so."""
        now = time.monotonic()
        self.timeline.grow(frames, now)
        self._frame.max, self._frame.disabled = max(frames - 1, 1), frames < 2
        self._play.disabled = frames < 2
        # groups of buttons cannot be disabled
        self._steps.visible = frames >= 2
        if self.follows_newest:
            self.timeline.seek(frames - 1, now)

    def _add_switches(self, gui: GuiApi, contents: Contents) -> None:
        bodies = any(take.motion.body is not None for take in contents.takes)
        markers = bool(contents.markers) or any(take.subject is not None for take in contents.takes)
        wanted = {
            "surface": ("Surface", bodies or bool(contents.meshes)),
            "skeleton": ("Skeleton", bodies),
            "frames": ("Joint frames", bool(contents.takes)),
            "names": ("Names", bool(contents.takes) or markers),
            "scan": ("Scan", bool(contents.clouds)),
            "markers": ("Markers", markers),
        }
        for field, (label, there) in wanted.items():
            if there:
                self._add_switch(gui, field, label)
        if contents.depths:
            for name in LAYER_COLOURS:
                self._add_layer_switch(gui, name)
        if len(contents.takes) > 1:
            beside = gui.add_checkbox("Side by side", self.spacing != 0)
            beside.on_update(lambda event: self._set_spacing(event.target.value))
        if bodies and contents.clouds:
            colours = gui.add_dropdown("Colours", (PLAIN, DISTANCE, POSTERIOR), initial_value=PLAIN)
            limit = gui.add_number(
                "Scale, mm", 1000 * self.choice.limit, min=0.1, max=1000.0, step=0.1, visible=False
            )
            legend = gui.add_html(heat_legend(self.choice.limit), visible=False)

            @colours.on_update
            def _(event) -> None:
                limit.visible = legend.visible = event.target.value == DISTANCE
                self._choose(colours=event.target.value)

            @limit.on_update
            def _(event) -> None:
                legend.content = heat_legend(0.001 * event.target.value)
                self._choose(limit=0.001 * event.target.value)

    def _add_switch(self, gui: GuiApi, field: str, label: str) -> None:
        box = gui.add_checkbox(label, getattr(self.choice, field))
        box.on_update(lambda event: self._choose(**{field: bool(event.target.value)}))

    def _add_layer_switch(self, gui: GuiApi, name: str) -> None:
        box = gui.add_checkbox(name.capitalize(), name in self.choice.layers)

        @box.on_update
        def _(event) -> None:
            others = [layer for layer in self.choice.layers if layer != name]
            self._choose(layers=(*others, name) if event.target.value else tuple(others))

    def _choose(self, **changes) -> None:
        self.choice = dataclasses.replace(self.choice, **changes)
        self._changed()

    def _set_spacing(self, side_by_side: bool) -> None:
        self.spacing = (self._initial_spacing or None) if side_by_side else 0.0
        self._changed()

    def _seek(self, frame: int, by_hand: bool) -> None:
        if not by_hand:
            return
        self.follows_newest = False
        self.timeline.seek(frame, time.monotonic())
        self._changed()

    def _toggle_play(self) -> None:
        now = time.monotonic()
        if self.timeline.playing:
            self.timeline.pause(now)
        else:
            self.timeline.play(now)
        self._play.label = PAUSE if self.timeline.playing else PLAY
        self._changed()

    def _step(self, frames: int) -> None:
        self.follows_newest = False
        self.timeline.step(frames, time.monotonic())
        self._play.label = PLAY
        self._changed()

    def _set_speed(self, speed: float) -> None:
        self.timeline.set_speed(speed, time.monotonic())
        self._changed()

    def _follow(self, follows_newest: bool) -> None:
        self.follows_newest = follows_newest
        if follows_newest:
            self.timeline.seek(self.timeline.frames - 1, time.monotonic())
        self._changed()
