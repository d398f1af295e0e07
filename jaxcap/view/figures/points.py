"""Points in a window: scans, markers, and meshes that have no faces."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, UInt8

from .figure import Colour

if TYPE_CHECKING:
    from viser import SceneApi
else:
    SceneApi = Any

#: of a scan, and of markers
SAND: Colour = (214, 160, 74)
MARKER: Colour = (66, 138, 219)
#: metres across
DOT = 0.008


class PointFigure:
    """Points that move and change in number, of one colour or each of its own.

    **Arguments:** `scene` and `name` as of `BodyFigure`; `colour`; `size` of a point, metres.
    """

    def __init__(self, scene: SceneApi, name: str, colour: Colour = SAND, size: float = DOT):
        self._colour = np.array(colour, np.uint8)
        self.node = scene.add_point_cloud(
            name, np.zeros((1, 3), np.float32), colour, point_size=size, point_shape="circle",
            precision="float32", point_shading="flat", visible=False,
        )  # fmt: skip

    def show(self, points: Float[np.ndarray, "N 3"], colours: UInt8[np.ndarray, "N 3"] | None = None) -> None:
        """Move them, metres. Without points there is nothing to see."""
        self.node.visible = len(points) > 0
        if len(points):
            # colours of another number than the points must not meet them
            if colours is None or len(colours) != len(self.node.points):
                self.node.colors = self._colour
            self.node.points = np.asarray(points, np.float32)
            if colours is not None:
                self.node.colors = colours

    def hide(self) -> None:
        """Send nothing, and show nothing."""
        self.node.visible = False


class LabelledPoints:
    """Points with names beside them where they are asked for; one that is not seen has neither."""

    def __init__(
        self, scene: SceneApi, name: str, labels: Sequence[str], colour: Colour = MARKER, size: float = 0.016
    ):
        self._scene, self._name, self._labels = scene, name, tuple(labels)
        self._points = PointFigure(scene, f"{name}/points", colour, size)
        self._texts: list[Any] = []

    def show(self, places: Float[np.ndarray, "M 3"], seen: np.ndarray, names: bool) -> None:
        """Move them, metres, those that are `seen (M,)`, with their names or without."""
        self._points.show(places[seen])
        if names and not self._texts:
            self._texts = [
                self._scene.add_label(f"{self._name}/names/{number}", label, font_screen_scale=0.7)
                for number, label in enumerate(self._labels)
            ]
        for text, place, there in zip(self._texts, places, seen, strict=False):
            text.visible = bool(names and there)
            if names and there:
                text.position = place

    def hide(self) -> None:
        """Send nothing, and show nothing."""
        self._points.hide()
        for text in self._texts:
            text.visible = False
