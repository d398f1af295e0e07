"""The scene of one browser: columns of takes, and around them meshes, markers, cameras and the floor."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...geometry.camera import Camera
from ...geometry.mesh import box_diagonal
from ...io.meshes.mesh import Mesh
from ..contents import Contents
from ..figures.depth_figure import DepthFigure
from ..figures.depth_layers import MEASURED
from ..figures.figure import BodyFigure
from ..figures.points import LabelledPoints
from ..figures.scenery import add_floor
from .column import Appearance, Choice, Column

if TYPE_CHECKING:
    from viser import SceneApi
else:
    SceneApi = Any

#: gap between two takes, metres
TAKE_GAP = 0.3
#: colours of a mesh next to a body, and of cameras
MESH_COLOUR, CAMERA_COLOUR = (205, 190, 160), (110, 112, 124)
#: colour of the pin at the clicked point
PIN_COLOUR = (214, 40, 57)


class SceneFigures:
    """The figures of `contents` in a scene of a server or of one client."""

    def __init__(self, scene: SceneApi, contents: Contents):
        self.contents, self._shown = contents, 0
        clouds = contents.clouds
        takes = contents.takes or [None] * max(1, len(clouds))
        # a single source of scans is for every take; several are assigned to the takes in order
        solid = [take is not None and take.motion.body is not None for take in takes]
        self.columns = [
            # bodies and skeletons without a surface have separate colours, each in order
            Column(
                scene,
                f"/{number}",
                solid[:number].count(solid[number]),
                take,
                _clouds_of_take(clouds, number),
            )
            for number, take in enumerate(takes)
        ]
        self._labels = [
            scene.add_label(f"/{number}/title", take.name, anchor="bottom-center", visible=False)
            for number, take in enumerate(contents.takes)
        ]
        self._meshes = [
            BodyFigure(scene, f"/mesh{number}", Mesh(meshes.vertices[0], meshes.faces), MESH_COLOUR)
            for number, meshes in enumerate(contents.meshes)
        ]
        self._markers = [
            LabelledPoints(scene, f"/markers{number}", markers.frames.labels)
            for number, markers in enumerate(contents.markers)
        ]
        self._depths = [DepthFigure(scene, f"/depth{number}") for number in range(len(contents.depths))]
        for number, camera in enumerate(contents.cameras):
            _add_camera(scene, f"/cameras/{number}", camera)
        self._offsets = [np.zeros(3) for _ in self.columns]
        size = box_diagonal(self.box())
        # half a metre for people
        self._floor = add_floor(scene, 6 * max(size, 1.0), 0.5 * 10.0 ** np.floor(np.log10(max(size, 0.01))))
        self._pin = scene.add_icosphere(
            "/picked", 0.006 * size, PIN_COLOUR, subdivisions=1, cast_shadow=False, visible=False
        )
        self.arrange(spacing=None)

    def arrange(self, spacing: float | None) -> None:
        """Arrange the takes in a row, `spacing` metres from one to the next, or automatically by their widths
        if None; or at zero overlay them, each at its recorded position.

        The first stays at its recorded position, as markers, meshes and cameras are in its world. The others
        follow in line with it on its floor.
        """
        boxes = [column.extent() for column in self.columns]
        widths = [float(np.ptp(box[:, 0])) for box in boxes]
        wide = max(widths) + TAKE_GAP if spacing is None else spacing
        foot = [np.array([box[:, 0].mean(), box[0, 1], box[:, 2].mean()]) for box in boxes]
        self._offsets = [
            np.zeros(3) if wide == 0 else foot[0] - own + np.array([number * wide, 0.0, 0.0])
            for number, own in enumerate(foot)
        ]
        box = self.box()
        self._floor.position = (float(box[:, 0].mean()), float(box[0, 1]), float(box[:, 2].mean()))
        for column, place in zip(self.columns, self._offsets, strict=True):
            column.group.position = place
        for label, own, place in zip(self._labels, boxes, self._offsets, strict=False):
            # all at one height, each over its own take
            label.position = (own[:, 0].mean(), box[1, 1] - place[1] + 0.06, own[:, 2].mean())
            label.visible = wide > 0 and len(self._labels) > 1

    def box(self, current: bool = False) -> Float[np.ndarray, "2 3"]:
        """Return the bounding box of everything but cameras as placed, in the first frame or the current one
        (`current`), metres."""
        there = [
            column.extent(current) + place
            for column, place in zip(self.columns, self._offsets, strict=True)
            if column.take is not None or column.clouds is not None
        ]
        there += _boxes(self.contents)
        return np.stack([np.min([box[0] for box in there], 0), np.max([box[1] for box in there], 0)])

    def pick(
        self, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"], choice: Choice
    ) -> str | None:
        """Mark the first object that a ray hits and return its description, or None if it hits nothing."""
        found = []
        for column, place in zip(self.columns, self._offsets, strict=True):
            picked = column.pick(origin - place, direction, choice)
            if picked is not None:
                found.append((np.linalg.norm(picked[1] + place - origin), picked[0], picked[1] + place))
        self._pin.visible = bool(found)
        if not found:
            return None
        _, name, there = min(found, key=lambda one: one[0])
        self._pin.position = there
        return name

    def appearances(self, frame: int, choice: Choice) -> list[Appearance]:
        """Compute the slow parts of one frame of the timeline; nothing is sent."""
        # kept there for `draw`
        self.notes(frame)
        return [column.appearance(frame / self.contents.rate, frame, choice) for column in self.columns]

    def notes(self, frame: int) -> list[str]:
        """List what is wrong with depth images of one frame of the timeline, in sentences; it may search for people."""
        return [layers[min(frame, len(layers) - 1)].note for layers in self.contents.depths]

    def draw(self, frame: int, looks: list[Appearance], choice: Choice) -> None:
        """Show one frame of the timeline."""
        if frame != self._shown:
            self._pin.visible, self._shown = False, frame
        time = frame / self.contents.rate
        for column, look in zip(self.columns, looks, strict=True):
            column.draw(look, choice)
        for figure, layers in zip(self._depths, self.contents.depths, strict=True):
            figure.show(layers[min(frame, len(layers) - 1)], choice.layers)
        for figure, meshes in zip(self._meshes, self.contents.meshes, strict=True):
            figure.visible = choice.surface
            if choice.surface:
                row = min(round(time * (meshes.rate or self.contents.rate)), len(meshes.vertices) - 1)
                figure.show(meshes.vertices[row])
        for figure, markers in zip(self._markers, self.contents.markers, strict=True):
            frames = markers.frames
            row = min(round(time * frames.rate), len(frames) - 1)
            if choice.markers:
                figure.show(np.asarray(frames.positions[row]), np.asarray(frames.visible[row]), choice.names)
            else:
                figure.hide()


def _clouds_of_take(clouds: list, number: int):
    if not clouds:
        return None
    return clouds[0] if len(clouds) == 1 else clouds[number] if number < len(clouds) else None


def _boxes(contents: Contents) -> list[Float[np.ndarray, "2 3"]]:
    """Return the bounding boxes of the first frame of meshes, markers and depth images, or of the cameras if nothing
    else is shown, metres."""
    points = [meshes.vertices[0] for meshes in contents.meshes]
    for markers in contents.markers:
        points.append(np.asarray(markers.frames.positions)[np.asarray(markers.frames.visible)][:200])
    for layers in contents.depths:
        measured = layers[0].layers[MEASURED].points
        if len(measured):
            # single pixels may be far away
            points.append(np.quantile(measured, [0.01, 0.99], axis=0))
    if not points and not contents.takes and not contents.clouds:
        points = [np.array([np.asarray(camera.eye) for camera in contents.cameras])]
    return [np.stack([some.min(0), some.max(0)]).astype(float) for some in points if len(some)]


def _add_camera(scene: SceneApi, name: str, camera: Camera) -> None:
    rotation = np.asarray(camera.rotation, float)
    scene.add_camera_frustum(
        name,
        fov=float(2 * np.arctan(0.5 * camera.height / np.asarray(camera.focal)[1])),
        aspect=camera.width / camera.height,
        scale=0.15,
        color=CAMERA_COLOUR,
        # from the camera to the world
        wxyz=Rotation.from_matrix(rotation.T).as_quat(scalar_first=True),
        position=np.asarray(camera.eye, float),
    )
