"""A node in a window that a figure hangs on, and which of its changes go over the wire."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from viser import SceneApi
else:
    SceneApi = Any


class Group:
    """What is hidden sends nothing while it is; what has changed meanwhile it sends when it is seen again.

    **Arguments:** `scene` and `name` as of `BodyFigure`; `at (3,)` metres, where its origin stands; `send` writes a
    figure as it is now to its nodes, which are below this one.
    """

    def __init__(self, scene: SceneApi, name: str, at: tuple[float, float, float], send: Callable[[], None]):
        self._node, self._send = scene.add_frame(name, show_axes=False, position=at), send

    @property
    def visible(self) -> bool:
        return self._node.visible

    def show(self, visible: bool) -> None:
        """Show it or hide it."""
        if visible and not self._node.visible:
            self._send()
        self._node.visible = visible

    def changed(self) -> None:
        """Send the figure, now or when it is seen again."""
        if self._node.visible:
            self._send()
