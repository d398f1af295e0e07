"""The viewer: one loop per browser, which shows the current frame of its timeline."""

import threading
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from .contents import Contents
from .figures.eye import BEGIN, FIELD, place_camera
from .live import POLL_SECONDS, RunFollower
from .windows.column import Choice
from .windows.controls import Controls
from .windows.scene_figures import SceneFigures
from .windows.serve import serve_clients

if TYPE_CHECKING:
    from viser import ClientHandle, SceneClickEvent, ViserServer
else:
    ClientHandle = SceneClickEvent = ViserServer = Any

#: maximum number of frames per second that are sent to a browser
MAX_FRAME_RATE = 60.0
#: seconds within which a closed browser is noticed
CLOSE_TIMEOUT = 0.25
#: the answer to a click that hits nothing
NO_HIT = "There is nothing where you clicked."


def serve_contents(
    server: ViserServer, contents: Contents, spacing: float | None = None
) -> list[RunFollower]:
    """Show `contents` to every browser that connects, each with its own timeline and choices.

    **Arguments:** `spacing` of takes as in `SceneFigures.arrange`. Unfinished runs are followed until the returned
    followers are stopped.
    """
    followers = [RunFollower(take) for take in contents.takes if take.run_folder is not None]
    for follower in followers:
        follower.start()
    serve_clients(server, lambda client, gone: Window(client, contents, spacing, followers).run(gone))
    return followers


class Window:
    """The window of one browser."""

    def __init__(
        self, client: ClientHandle, contents: Contents, spacing: float | None, followers: list[RunFollower]
    ):
        self.client, self.contents, self.followers = client, contents, followers
        self._wake = threading.Event()
        for take in contents.takes:
            # compiles before the browser has to wait for it
            take.motion.frame(0)
        with client.atomic():
            self.stage = SceneFigures(client.scene, contents)
            self.controls = Controls(client.gui, contents, spacing, self._wake.set, self.set_view)
            self.stage.arrange(spacing)
            client.camera.fov = float(FIELD)
            self.set_view(BEGIN)
        client.scene.on_click()(self._clicked)

    def set_view(self, name: str) -> None:
        """Set the camera to view everything shown, from a direction of `eye.DIRECTIONS`."""
        camera = self.client.camera
        size = float(camera.image_width), float(camera.image_height)
        eye, target = place_camera(self.stage.box(current=name != BEGIN), name, *size, camera.fov)
        with self.client.atomic():
            # in this order, as the target moves with the camera
            camera.position = eye
            camera.look_at = target

    def _clicked(self, event: SceneClickEvent) -> None:
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        with self.client.atomic():
            found = self.stage.pick(origin, direction, self.controls.choice)
            self.controls.show_description(found or NO_HIT)

    def run(self, gone: threading.Event) -> None:
        """Show the frame of the timeline with the current choices, until the browser closes."""
        shown: tuple[int, bool, Choice, tuple[int, ...], tuple[str, ...]] | None = None
        spacing, live = self.controls.spacing, any(take.run_folder for take in self.contents.takes)
        while not gone.is_set():
            self._wake.clear()
            start = time.monotonic()
            frames = self.contents.frames
            if frames != self.controls.timeline.frames:
                self.controls.grow(frames)
            versions = tuple(take.motion.version for take in self.contents.takes)
            errors = tuple(follower.error for follower in self.followers)
            frame, choice = self.controls.timeline.frame(start), self.controls.choice
            # includes whether it plays: the slider follows once more when it stops
            wanted = (frame, self.controls.timeline.playing, choice, versions, errors)
            if spacing != self.controls.spacing:
                spacing = self.controls.spacing
                self.stage.arrange(spacing)
            if wanted != shown:
                # computed before `atomic`, which holds messages to the browser back
                looks = self.stage.appearances(frame, choice)
                wrong = (*errors, *(look.error for look in looks), *self.stage.notes(frame))
                with self.client.atomic():
                    self.stage.draw(frame, looks, choice)
                    self.controls.draw(frame, next(filter(None, wrong), ""))
                shown = wanted
            now = time.monotonic()
            rest = self.controls.timeline.wait(now)
            rest = max(rest, start + 1.0 / MAX_FRAME_RATE - now, 0.0)
            self._wake.wait(min(rest, POLL_SECONDS if live else CLOSE_TIMEOUT))
