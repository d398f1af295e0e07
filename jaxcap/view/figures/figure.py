"""The surface of a body in a window.

Every change of an array sends that array and nothing else, and three.js writes it into its existing buffer.
For a surface of 5,000 vertices that is 60 kB a frame.

viser's plain mesh has one colour. Its meshes with vertex colours are `.glb` files: the browser parses a new
one for each frame and shows nothing meanwhile, so an animated heat map would flicker. A skinned mesh is sent
by its bones alone, but it uses linear blending of four bones a vertex, unlike our skins. So a coloured
surface is one plain mesh for each colour of a palette, with the triangles of that colour: faces are sent when
they change colour, and vertices when they move. A legend cannot distinguish more than a dozen colours either.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from ...body.body import Body
from ...io.meshes.mesh import Mesh
from .figure_node import FigureNode

if TYPE_CHECKING:
    from viser import SceneApi
else:
    SceneApi = Any

Colour = tuple[int, int, int]
#: default colour of a body
CLAY: Colour = (176, 186, 200)
#: opacity of a body whose bones are shown
TRANSLUCENT_OPACITY = 0.45
#: one degenerate triangle, as a mesh must have one
DEGENERATE_FACE = np.zeros((1, 3), np.uint32)


class BodyFigure:
    """The surface of a body or a mesh, or its vertices as points if it has no faces.

    **Arguments:** `scene` of a server (all browsers see it) or of one client; `name` in the scene tree, such
    as `/body`; `body`; `colour`, red, green and blue to 255; `at (3,)` metres, the position of its origin.
    """

    def __init__(
        self,
        scene: SceneApi,
        name: str,
        body: Body | Mesh,
        colour: Colour = CLAY,
        at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ):
        self.name = name
        self._group = FigureNode(scene, name, at, self._send)
        self._scene, self._colour = scene, colour
        self._faces = np.asarray(body.faces, np.uint32)
        self._vertices = np.asarray(body.vertices, np.float32)
        self._parts: list[_ColourPart] = []
        self._classes: np.ndarray | None = None
        self._palette: np.ndarray | None = None
        self._translucent = False
        self._whole = self._add_whole()

    def show(self, vertices: Float[Array, "V 3"] | Float[np.ndarray, "V 3"]) -> None:
        """Move the vertices, metres. A hidden figure sends them when it is shown again."""
        self._vertices = np.asarray(vertices, np.float32)
        self._group.send_if_visible()

    def colours(
        self, classes: Int[np.ndarray, "V"] | None, palette: UInt8[np.ndarray, "K 3"] | None = None
    ) -> None:
        """Colour every vertex with `palette[classes]`, or reset the surface to its own colour (None).

        A triangle has the median of its corners' classes, so an ordered palette makes bands.
        """
        if classes is None or palette is None:
            self._classes = self._palette = None
        else:
            self._classes, self._palette = np.asarray(classes), np.asarray(palette)
        self._group.send_if_visible()

    @property
    def visible(self) -> bool:
        return self._group.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._group.show(visible)

    @property
    def translucent(self) -> bool:
        """True if the surface is see-through; points are always opaque."""
        return self._translucent

    @translucent.setter
    def translucent(self, translucent: bool) -> None:
        self._translucent = translucent
        if len(self._faces):
            self._whole.opacity = TRANSLUCENT_OPACITY if translucent else None
            for part in self._parts:
                part.translucent(translucent)

    def _add_whole(self) -> Any:
        if not len(self._faces):
            return self._scene.add_point_cloud(
                f"{self.name}/points", self._vertices, self._colour, point_size=0.006, point_shape="circle",
                precision="float32", point_shading="flat",
            )  # fmt: skip
        return _surface(self._scene, f"{self.name}/surface", self._vertices, self._faces, self._colour)

    def _send(self) -> None:
        if not len(self._faces):
            self._whole.points = self._vertices
            self._whole.colors = (
                np.array(self._colour, np.uint8)
                if self._classes is None or self._palette is None
                else self._palette[self._classes]
            )
        elif self._classes is None or self._palette is None:
            self._whole.vertices = self._vertices
            self._whole.visible = True
            for part in self._parts:
                part.hide()
        else:
            self._send_parts(self._classes, self._palette)
            self._whole.visible = False

    def _send_parts(self, classes: np.ndarray, palette: np.ndarray) -> None:
        triangles = np.sort(classes[self._faces], axis=1)[:, 1]
        while len(self._parts) < len(palette):
            self._parts.append(_ColourPart(self._scene, f"{self.name}/colour{len(self._parts)}"))
        for number, part in enumerate(self._parts):
            chosen = triangles == number
            if number < len(palette) and chosen.any():
                part.show(self._vertices, self._faces, chosen, palette[number])
                part.translucent(self._translucent)
            else:
                part.hide()


class _ColourPart:
    """The triangles of one colour, with only the vertices that they use."""

    def __init__(self, scene: SceneApi, name: str):
        self._mesh = _surface(scene, name, np.zeros((1, 3), np.float32), DEGENERATE_FACE, CLAY)
        self._mesh.visible = False
        self._chosen = np.zeros(0, bool)
        self._kept = np.zeros(0, int)

    def show(self, vertices: np.ndarray, faces: np.ndarray, chosen: np.ndarray, colour: np.ndarray) -> None:
        corners = None
        if not np.array_equal(chosen, self._chosen):
            corners = faces[chosen]
            touched = np.zeros(len(vertices), bool)
            touched[corners] = True
            # no face may index a missing vertex, not even between two messages
            fewer = touched.sum() < len(self._kept)
            self._chosen, self._kept = chosen, np.flatnonzero(touched)
            corners = (np.cumsum(touched) - 1)[corners].astype(np.uint32)
            if fewer:
                self._mesh.faces = corners
        self._mesh.vertices = vertices[self._kept]
        if corners is not None:
            self._mesh.faces = corners
        self._mesh.color = (int(colour[0]), int(colour[1]), int(colour[2]))
        self._mesh.visible = True

    def translucent(self, translucent: bool) -> None:
        self._mesh.opacity = TRANSLUCENT_OPACITY if translucent else None

    def hide(self) -> None:
        self._mesh.visible = False


def _surface(scene: SceneApi, name: str, vertices: np.ndarray, faces: np.ndarray, colour: Colour) -> Any:
    return scene.add_mesh_simple(
        name, vertices, faces, color=colour, side="double", cast_shadow=False, receive_shadow=False
    )
