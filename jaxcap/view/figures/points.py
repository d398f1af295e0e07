"""Points in a window: scans, markers, and meshes without faces."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, UInt8

from .figure import Colour

if TYPE_CHECKING:
    from viser import SceneApi
else:
    SceneApi = Any

#: colours of a scan and of markers
SCAN_COLOUR: Colour = (214, 160, 74)
MARKER_COLOUR: Colour = (66, 138, 219)
#: diameter, metres
POINT_SIZE = 0.008


class PointFigure:
    """Points that move and change in number, with one colour or one each.

    **Arguments:** `scene` and `name` as of `BodyFigure`; `colour`; `size` of a point, metres.
    """

    def __init__(self, scene: SceneApi, name: str, colour: Colour = SCAN_COLOUR, size: float = POINT_SIZE):
        self._colour = np.array(colour, np.uint8)
        self.node = scene.add_point_cloud(
            name, np.zeros((1, 3), np.float32), colour, point_size=size, point_shape="circle",
            precision="float32", point_shading="flat", visible=False,
        )  # fmt: skip

    def show(self, points: Float[np.ndarray, "N 3"], colours: UInt8[np.ndarray, "N 3"] | None = None) -> None:
        """Set the positions, metres. Without points the figure is hidden."""
        self.node.visible = len(points) > 0
        if len(points):
            # the numbers of colours and of points must agree after every message
            if colours is None or len(colours) != len(self.node.points):
                self.node.colors = self._colour
            self.node.points = np.asarray(points, np.float32)
            if colours is not None:
                self.node.colors = colours

    def hide(self) -> None:
        """Hide the points; nothing is sent."""
        self.node.visible = False


class LabelledPoints:
    """Points with optional name labels; a point that is not observed has neither dot nor label."""

    def __init__(
        self,
        scene: SceneApi,
        name: str,
        labels: Sequence[str],
        colour: Colour = MARKER_COLOUR,
        size: float = 0.016,
    ):
        self._scene, self._name, self._labels = scene, name, tuple(labels)
        self._points = PointFigure(scene, f"{name}/points", colour, size)
        self._texts: list[Any] = []

    def show(self, positions: Float[np.ndarray, "M 3"], seen: np.ndarray, names: bool) -> None:
        """Set the positions, metres, of the observed points `seen (M,)`, with or without names."""
        self._points.show(positions[seen])
        if names and not self._texts:
            self._texts = [
                self._scene.add_label(f"{self._name}/names/{number}", label, font_screen_scale=0.7)
                for number, label in enumerate(self._labels)
            ]
        for text, place, there in zip(self._texts, positions, seen, strict=False):
            text.visible = bool(names and there)
            if names and there:
                text.position = place

    def hide(self) -> None:
        """Hide the points and their names; nothing is sent."""
        self._points.hide()
        for text in self._texts:
            text.visible = False
