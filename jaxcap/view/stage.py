"""All that one browser sees: columns of takes, and around them meshes, markers, cameras and the ground."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ..geometry.camera import Camera
from ..io.mesh import Mesh
from .column import Choice, Column, Look
from .contents import Contents
from .figure import BodyFigure
from .points import LabelledPoints

if TYPE_CHECKING:
    from viser import SceneApi
else:
    SceneApi = Any

#: metres of air between two takes
AIR = 0.3
#: of a mesh beside a body, and of what is not the matter
MESH, FAINT = (205, 190, 160), (150, 150, 160)


class Stage:
    """The figures of `contents` in a scene of a server or of one client."""

    def __init__(self, scene: SceneApi, contents: Contents):
        self.contents = contents
        clouds = contents.clouds
        takes = contents.takes or [None] * max(1, len(clouds))
        # one source of scans is for every take; several go with the takes in turn
        self.columns = [
            Column(scene, f"/{number}", number, take, _of(clouds, number))
            for number, take in enumerate(takes)
        ]
        self._labels = [
            scene.add_label(f"/{number}/title", take.name, anchor="bottom-center", visible=False)
            for number, take in enumerate(contents.takes)
        ]
        self._meshes = [
            BodyFigure(scene, f"/mesh{number}", Mesh(meshes.vertices[0], meshes.faces), MESH)
            for number, meshes in enumerate(contents.meshes)
        ]
        self._markers = [
            LabelledPoints(scene, f"/markers{number}", markers.frames.labels)
            for number, markers in enumerate(contents.markers)
        ]
        for number, camera in enumerate(contents.cameras):
            _add_camera(scene, f"/cameras/{number}", camera)
        low, high = self.extent = _extent(self.columns, contents)
        self._widths = [np.ptp(column.extent(), axis=0)[0] for column in self.columns]
        self._high = float(high[1])
        size = float(max(high[0] - low[0], high[2] - low[2], 1.0)) * 6
        scene.add_grid(
            "/ground", width=size, height=size, plane="xz", position=(0.0, float(low[1]), 0.0),
            cell_size=1.0, section_size=5.0, cell_color=(225, 225, 228), section_color=(205, 205, 210),
        )  # fmt: skip
        self.place(spacing=None)

    def place(self, spacing: float | None) -> None:
        """Takes beside each other, `spacing` metres apart, as far as their widths ask where None, and over each
        other at zero."""
        apart = max(self._widths, default=0.0) + AIR if spacing is None else spacing
        for number, column in enumerate(self.columns):
            column.group.position = (number * apart, 0.0, 0.0)
        for column, label in zip(self.columns, self._labels, strict=False):
            middle = column.extent().mean(0)
            label.position = (float(middle[0]), self._high + 0.1, float(middle[2]))
            label.visible = apart > 0 and len(self._labels) > 1

    def look(self, frame: int, choice: Choice) -> list[Look]:
        """What takes time to compute for one frame of the timeline; nothing is sent."""
        return [column.look(frame / self.contents.rate, frame, choice) for column in self.columns]

    def draw(self, frame: int, looks: list[Look], choice: Choice) -> None:
        """Show one frame of the timeline."""
        time = frame / self.contents.rate
        for column, look in zip(self.columns, looks, strict=True):
            column.draw(look, choice)
        for figure, meshes in zip(self._meshes, self.contents.meshes, strict=True):
            figure.visible = choice.surface
            if choice.surface:
                row = min(round(time * (meshes.rate or self.contents.rate)), len(meshes.vertices) - 1)
                figure.show(meshes.vertices[row])
        for figure, markers in zip(self._markers, self.contents.markers, strict=True):
            frames = markers.frames
            row = min(round(time * frames.rate), len(frames) - 1)
            if choice.markers:
                figure.show(np.asarray(frames.places[row]), np.asarray(frames.seen[row]), choice.names)
            else:
                figure.hide()

    def view(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Where an eye sees everything from, and what it looks at, metres."""
        low, high = self.extent.copy()
        high[0] += (len(self.columns) - 1) * (max(self._widths) + AIR)
        middle, size = 0.5 * (low + high), float(np.linalg.norm(high - low))
        return middle + size * np.array([0.25, 0.25, 1.1]), middle


def _of(clouds: list, number: int):
    if not clouds:
        return None
    return clouds[0] if len(clouds) == 1 else clouds[number] if number < len(clouds) else None


def _extent(columns: list[Column], contents: Contents) -> Float[np.ndarray, "2 3"]:
    """The box around the first frame of all but cameras, metres."""
    boxes = [column.extent() for column in columns if column.take is not None or column.clouds is not None]
    boxes += [np.stack([meshes.vertices[0].min(0), meshes.vertices[0].max(0)]) for meshes in contents.meshes]
    for markers in contents.markers:
        first = np.asarray(markers.frames.places)[np.asarray(markers.frames.seen)][:200]
        boxes.append(np.stack([first.min(0), first.max(0)]))
    if not boxes:
        eyes = np.array([np.asarray(camera.eye) for camera in contents.cameras])
        boxes = [np.stack([eyes.min(0), eyes.max(0)])]
    return np.stack([np.min([box[0] for box in boxes], 0), np.max([box[1] for box in boxes], 0)]).astype(
        float
    )


def _add_camera(scene: SceneApi, name: str, camera: Camera) -> None:
    rotation = np.asarray(camera.rotation, float)
    scene.add_camera_frustum(
        name,
        fov=float(2 * np.arctan(0.5 * camera.height / np.asarray(camera.focal)[1])),
        aspect=camera.width / camera.height,
        scale=0.15,
        color=FAINT,
        # from the camera to the world
        wxyz=Rotation.from_matrix(rotation.T).as_quat(scalar_first=True),
        position=np.asarray(camera.eye, float),
    )
