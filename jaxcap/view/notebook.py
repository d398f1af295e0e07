"""Display of a program's or a notebook's data in memory."""

import html
import webbrowser
from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Float

from ..arguments import checked
from ..body.body import Body
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from ..geometry.camera import Camera
from ..io.meshes.clouds import NO_FACES, Scans
from ..observe.clouds import Cloud
from ..observe.markers import MarkerFrames
from .app import serve_contents
from .contents import Contents, Markers, make_take
from .figures.clouds import DisplayClouds
from .figures.eye import FIELD, place_camera
from .windows.column import DISTANCE, Choice
from .windows.scene_figures import SceneFigures
from .windows.serve import address, close_server, open_server

#: maximum number of frames of a recording; one of 5,000 vertices is some 50 kB
MAX_RECORDED_FRAMES = 120
#: points of a scan in a recording
MAX_RECORDED_POINTS = 4_000

Points = Float[Array, "N 3"] | Float[np.ndarray, "N 3"]


class Player:
    """The result of `show`: an animation in a notebook, or a window after `open`.

    A cell that ends with it contains a recording, which needs no server and stays in the page; `open` starts
    a server with all controls of `jaxcap view`, until `close`.
    """

    def __init__(self, contents: Contents, heat: bool = False, height: int = 420):
        self.contents, self.heat, self.height = contents, heat, height
        self._server = None

    def open(self, port: int | None = None, browser: bool = True) -> str:
        """Open a window and return its address. Raises `InputError` as `open_server` does."""
        if self._server is None:
            self._server = open_server(port, title="jaxcap view")
            serve_contents(self._server, self.contents)
        if browser:
            webbrowser.open(address(self._server))
        return address(self._server)

    def close(self) -> None:
        """Close the window's server."""
        if self._server is not None:
            close_server(self._server)
            self._server = None

    def page(self, frames: int = MAX_RECORDED_FRAMES) -> str:
        """Render a complete HTML page that plays the animation anywhere, with about `frames` frames, evenly
        spaced.

        Raises `InputError` if viser is not installed.
        """
        count = self.contents.frames
        step = max(1, -(-count // frames))
        choice = Choice(colours=DISTANCE) if self.heat else Choice()
        server = open_server(0)
        try:
            stage = SceneFigures(server.scene, self.contents)
            eye, target = place_camera(stage.box())
            server.initial_camera.fov = float(FIELD)
            server.initial_camera.position, server.initial_camera.look_at = tuple(eye), tuple(target)
            stage.draw(0, stage.appearances(0, choice), choice)
            recording = server.get_scene_serializer()
            for frame in range(step, count, step):
                recording.insert_sleep(step / self.contents.rate)
                stage.draw(frame, stage.appearances(frame, choice), choice)
            recording.insert_sleep(step / self.contents.rate)
            return recording.as_html()
        finally:
            close_server(server)

    def _repr_html_(self) -> str:
        page = html.escape(self.page(), quote=True)
        return f'<iframe srcdoc="{page}" width="100%" height="{self.height}" style="border: none"></iframe>'


@checked
def show(
    body: Body | Skeleton,
    motion: Motion | Pose | None = None,
    cloud: Points | Cloud | Sequence[Points] | None = None,
    *,
    markers: MarkerFrames | None = None,
    cameras: Sequence[Camera] = (),
    heat: bool = False,
    name: str = "body",
) -> Player:
    """Show a body or a skeleton in motion.

    **Arguments:** `motion`, or one pose, or the rest pose if not given; `cloud`, the points of one scan or of
    one for each frame, metres; `markers`; `cameras`; `heat`, whether a recording is coloured by the distance
    of the scans; `name`, its label in the window.

    **Raises:** `ValueError` if the motion has another number of joints than the body.
    """
    skeleton, surface = (body.skeleton, body) if isinstance(body, Body) else (body, None)
    contents = Contents(
        takes=[make_take(name, skeleton, surface, motion)],
        clouds=[] if cloud is None else [_make_clouds(cloud)],
        markers=[] if markers is None else [Markers("markers", markers)],
        cameras=list(cameras),
    )
    return Player(contents, heat)


def _make_clouds(cloud: Points | Cloud | Sequence[Points]) -> DisplayClouds:
    if isinstance(cloud, Cloud):
        points, seen = np.asarray(cloud.points, float), np.asarray(cloud.weights) > 0
        rows = [points[seen]] if points.ndim == 2 else [p[s] for p, s in zip(points, seen, strict=True)]
    elif isinstance(cloud, (list, tuple)):
        rows = [np.asarray(points, float) for points in cloud]
    else:
        rows = [np.asarray(cloud, float)]
    names = [f"scan {number}" for number in range(len(rows))]
    return DisplayClouds(
        Scans(names, lambda frame: (rows[frame], None, NO_FACES)), max_points=MAX_RECORDED_POINTS
    )
