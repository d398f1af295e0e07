"""The parent node of a figure in a window, which sends changes only while it is visible."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from viser import SceneApi
else:
    SceneApi = Any


class FigureNode:
    """A scene node that sends nothing while it is hidden, and sends its last state when it is shown again.

    **Arguments:** `scene` and `name` as of `BodyFigure`; `at (3,)` metres, the position of its origin; `send`
    writes the current state of a figure to its nodes, which are children of this one.
    """

    def __init__(self, scene: SceneApi, name: str, at: tuple[float, float, float], send: Callable[[], None]):
        self._node, self._send = scene.add_frame(name, show_axes=False, position=at), send

    @property
    def visible(self) -> bool:
        return self._node.visible

    def show(self, visible: bool) -> None:
        """Show or hide the node."""
        if visible and not self._node.visible:
            self._send()
        self._node.visible = visible

    def send_if_visible(self) -> None:
        """Send the figure, now or when it is shown again."""
        if self._node.visible:
            self._send()
