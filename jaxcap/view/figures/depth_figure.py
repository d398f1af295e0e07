"""The layers of depth images in a window: points of one colour, and labels."""

from collections.abc import Collection
from typing import TYPE_CHECKING, Any

from .depth_layers import LAYER_COLOURS, FrameLayers, Layer
from .points import PointFigure

if TYPE_CHECKING:
    from viser import SceneApi
else:
    SceneApi = Any

#: diameter of a point, metres
LAYER_POINT_SIZE = 0.01


class DepthFigure:
    """The layers of one frame; each can be hidden.

    **Arguments:** `scene` and `name` as of `BodyFigure`.
    """

    def __init__(self, scene: SceneApi, name: str):
        self._scene, self._name = scene, name
        self._points = {
            layer: PointFigure(scene, f"{name}/{layer.replace(' ', '_')}", colour, LAYER_POINT_SIZE)
            for layer, colour in LAYER_COLOURS.items()
        }
        self._texts: dict[str, list[Any]] = {layer: [] for layer in LAYER_COLOURS}

    def show(self, frame: FrameLayers, shown: Collection[str]) -> None:
        """Show the layers with the names `shown`, and hide the others."""
        for name, figure in self._points.items():
            layer = frame.layers[name]
            if name in shown:
                figure.show(layer.points)
            else:
                figure.hide()
            self._show_labels(name, layer, name in shown)

    def _show_labels(self, name: str, layer: Layer, shown: bool) -> None:
        texts = self._texts[name]
        if shown:
            for number in range(len(texts), len(layer.labels)):
                path = f"{self._name}/{name.replace(' ', '_')}_label{number}"
                texts.append(self._scene.add_label(path, "", font_screen_scale=0.7))
        for number, text in enumerate(texts):
            text.visible = shown and number < len(layer.labels)
            if text.visible:
                text.text, text.position = layer.labels[number]
